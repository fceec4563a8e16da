"""Robots that a visitor leads, and what is kept of it."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command import run as lemma
from looked_at import (
    STACK,
    StandsStill,
    player_of,
    rollout_of,
    session_of,
    until,
    until_phase,
)

from lemma import make
from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.poses import Pose2
from lemma.dataset.teleoperation import (
    Commanded,
    Executed,
    Teleoperation,
    is_same,
    perform,
)
from lemma.env.episode import Episode
from lemma.evaluation.run.loading import load_policy
from lemma.policies.control.recorded import Recorded
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import Instance
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.session import Session
from lemma.viewer.episode.status import EpisodeRequest, Phase
from lemma.viewer.episode.teleoperator import BY_HAND, Teleoperator

REQUEST = replace(STACK, policy=BY_HAND)
STEPS = 30


def hand_of(play: Play) -> Teleoperator:
    def has_target() -> bool:
        hand = play.teleoperator
        return hand is not None and hand.target(0) is not None

    until(has_target, play)
    assert play.teleoperator is not None
    return play.teleoperator


def lead(play: Play, seconds: float) -> None:
    """Send the hand of the first robot aside and down, and close it."""
    hand = hand_of(play)
    goal = hand.target(0)
    assert goal is not None
    hand.lead(0, goal[:3] - (0.0, 0.1, 0.1), goal[3:7])
    hand.grip(0, opened=False)
    until(lambda: play.transport.cursor_s > seconds, play)


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    found = Session(REQUEST, ("oracle", BY_HAND), player_of())
    found.ask(REQUEST, acts=True)
    lead(found.play, 3.0)
    found.play.transport.pause()
    yield found
    found.close()


@pytest.fixture(scope="module")
def file(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hand") / "mine.json"
    path.write_text(session.play.kept().to_json())
    return path


def test_hand_goes_where_it_is_led(session: Session) -> None:
    arm = rollout_of(session.play).episode.simulation.arms["robot_0"]
    goal = hand_of(session.play).target(0)
    assert goal is not None
    assert arm.tcp_pose()[:3, 3] == pytest.approx(goal[:3], abs=0.02)
    assert arm.scene.opening_m(arm.robot) < 0.01


def test_saved_episode_repeats_to_the_bit(session: Session, file: Path) -> None:
    name = f"{Recorded.__module__}:{Recorded.__name__}"
    arguments = (("file", str(file)),)
    policy = load_policy(
        PolicySpec(name, level="control", arguments=arguments, timeout_s=0)
    )
    instance = Instance.load(file)
    options = {**policy.control_options, "split": "free"}
    env: Any = make("stack", **options)
    env.reset(options={"instance": instance})
    for step in range(STEPS):
        (answer,) = policy.act([SimpleNamespace(step=step)])
        env.step(answer.rows)
    session.play.transport.seek(STEPS / 20.0)
    seen = session.play.transport.qpos()
    assert seen is not None
    again = env.unwrapped.episode.simulation.scene.data.qpos
    assert np.array_equal(seen, again)
    env.close()


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an episode of the expert in which a visitor led for a while.

    Meanwhile the visitor laid the cube elsewhere, as no robot could.
    """
    found = session_of()
    found.ask(STACK, acts=True)
    play = found.play
    until(lambda: play.transport.cursor_s > 1.2, play)
    play.take_over()
    until(lambda: play.is_led, play)
    lead(play, 3.0)
    assert play.instance is not None
    (top, _), *_ = play.instance.goal.pairs
    lies = play.instance.scene.placement(top).pose
    play.nudge(top, Pose2(lies.x + 0.03, lies.y, lies.yaw))
    until(lambda: play.moved is not None, play)
    assert play.moved is not None
    assert not play.moved.problem
    play.hand_back()
    until_phase(play, Phase.SOLVED)
    until(lambda: play.wait(0.0), play)
    words = [(line.words, line.outcome) for line in play.status.lines]
    path = tmp_path_factory.mktemp("taken") / "taken.json"
    path.write_text(play.kept().to_json())
    found.close()
    assert words[0][1] == "taken over"
    assert ("You lead the robots", "by hand") in words
    return path


def test_policy_goes_on_where_a_visitor_hands_back(taken: Path) -> None:
    parts = Teleoperation.load(taken).parts
    first, led, *rest = parts
    assert isinstance(first, Executed)
    assert isinstance(led, Commanded)
    assert first.until_s == led.start_s
    assert 0.0 < led.start_s < 3.0
    assert len(led.rows) > STEPS
    assert rest
    assert all(isinstance(part, Executed) and part.until_s is None for part in rest)


@pytest.mark.slow
def test_it_is_replayed_to_the_bit(taken: Path, tmp_path: Path) -> None:
    assert lemma("replay", taken) == 0
    # A tenth of a millimetre, for a twentieth of a second, is noticed.
    changed = json.loads(taken.read_text())
    changed["done"]["commanded"][0]["rows"][10][0][0] += 1e-4
    other = tmp_path / "other.json"
    other.write_text(json.dumps(changed))
    assert lemma("replay", other) == 1


@pytest.mark.slow
def test_it_is_shown_again_and_whole(
    taken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lemma("replay", taken, "--browser", tmp_path) == 0
    page = (tmp_path / "index.html").read_text()
    assert "Led by hand" in page
    assert "was moved" in page
    assert "It went differently" not in page
    for more in ([], ["--browser", tmp_path]):
        assert lemma("replay", taken, "--limit", "1", *more) == 2
        assert "a single episode" in capsys.readouterr().err


def test_commands_alone_are_no_whole_episode(taken: Path) -> None:
    with pytest.raises(InvalidConfigError, match="lemma replay"):
        Recorded(str(taken))


def test_only_a_running_episode_is_taken_over_in_a_pause_too() -> None:
    found = session_of(still=StandsStill())
    with pytest.raises(InvalidConfigError, match="while an episode runs"):
        found.play.take_over()
    with pytest.raises(InvalidConfigError, match="by hand"):
        found.play.kept()
    found.ask(replace(STACK, policy="still"), acts=True)
    until(lambda: found.play.transport.cursor_s > 0.1, found.play)
    with pytest.raises(InvalidConfigError, match="motor commands"):
        found.play.take_over()
    with pytest.raises(InvalidConfigError, match="are not kept"):
        found.play.kept()
    found.ask(STACK, acts=True)
    play = found.play
    until(lambda: play.transport.cursor_s > 0.5, play)
    play.transport.pause()
    play.take_over()
    until(lambda: play.is_led)
    assert not play.transport.playing
    found.close()
    assert play.wait(5.0)


TASKS = ("pass", "stack", "poke", "hook")
DEEDS = 30
MOST_S = 25.0


def lead_anywhere(play: Play, luck: Random) -> None:
    robot, hand = luck.randrange(2), play.teleoperator
    goal = None if hand is None else hand.target(robot)
    if hand is not None and goal is not None:
        by = np.array([luck.uniform(-0.2, 0.2) for _ in range(3)])
        hand.lead(robot, goal[:3] + by, goal[3:7])
        hand.grip(robot, opened=luck.random() < 0.5)


def nudge(play: Play, luck: Random) -> None:
    if play.rollout is not None and not play.transport.over:
        placed = luck.choice(play.rollout.instance.scene.objects)
        by = luck.uniform(-0.1, 0.1), luck.uniform(-0.1, 0.1)
        to = Pose2(placed.pose.x + by[0], placed.pose.y + by[1], placed.pose.yaw)
        play.nudge(placed.name, to)


def wait(play: Play, luck: Random) -> None:
    enough_s = min(play.transport.cursor_s + luck.uniform(0.05, 2.0), MOST_S)
    play.transport.play()
    until(lambda: play.transport.cursor_s >= enough_s or play.transport.over, play)


WHAT = {
    "take over": lambda play, luck: play.take_over(),
    "hand back": lambda play, luck: play.hand_back(),
    "pause": lambda play, luck: play.transport.pause(),
    "lead": lead_anywhere,
    "nudge": nudge,
    "wait": wait,
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_saved_at_any_moment_repeats_to_the_bit(seed: int, tmp_path: Path) -> None:
    luck, kept = Random(seed), []
    session = session_of(EpisodeRequest(TASKS[seed], "train", seed))
    session.ask(session.play.request, acts=True)
    play = session.play
    until(lambda: play.transport.latest is not None, play)
    # At least one thing is done by hand.
    deeds = ["wait", "take over", "lead", "wait"]
    for deed in deeds + luck.choices(list(WHAT), (3, 2, 1, 4, 1, 4), k=DEEDS):
        try:
            WHAT[deed](play, luck)
        except LemmaError:
            # It is over, or somebody leads already.
            continue
        if deed == "take over" or luck.random() < 0.3:
            # Also while others are at work.
            try:
                kept.append(play.kept())
            except LemmaError:
                continue
    kept.append(play.kept())
    session.close()
    assert any(isinstance(part, Executed) for part in kept[-1].parts)
    assert any(isinstance(part, Commanded) for part in kept[-1].parts)
    for number, done in enumerate(kept):
        path = tmp_path / f"{number}.json"
        path.write_text(done.to_json())
        again = Teleoperation.load(path)
        episode = Episode(again.instance)
        perform(again, episode)
        assert is_same(again, episode), (number, len(kept))
