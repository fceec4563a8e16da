"""Random actions of visitors: a saved episode repeats them to the bit."""

from pathlib import Path
from random import Random

import numpy as np
import pytest
from looked_at import session_of, until

from lemma.core.errors import LemmaError
from lemma.core.poses import Pose2
from lemma.dataset.teleoperation import (
    Commanded,
    Executed,
    Teleoperation,
    is_same,
    perform,
)
from lemma.env.episode import Episode
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.request import EpisodeRequest

TASKS = ("pass", "stack", "poke", "hook")
DEEDS = 30
MOST_S = 25.0


def lead(play: Play, luck: Random) -> None:
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
    "lead": lead,
    "nudge": nudge,
    "wait": wait,
}


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 4))]
)
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
