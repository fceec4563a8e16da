"""Dragging: tables that visitors change, and things moved while robots wait."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from looked_at import STACK, rollout_of, session_of, until, until_phase

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.tasks.instance import OWN_SPLIT
from lemma.tasks.rules import problems
from lemma.tasks.suite import load_instance
from lemma.viewer.episode.session import Session, moved
from lemma.viewer.episode.status import Phase

INSTANCE = load_instance("stack", "test", 0)
((TOP, BOTTOM),) = INSTANCE.goal.pairs
PAD = next(o.name for o in INSTANCE.scene.objects if o.kind == "pad")
FREE = Pose2(0.1, 0.7)


@pytest.fixture
def session() -> Iterator[Session]:
    found = session_of(STACK)
    yield found
    found.close()


def begin(session: Session) -> None:
    """Let an episode go on for a while, and pause it."""
    session.ask(STACK, acts=True)
    until(lambda: session.play.transport.cursor_s > 1.0, session.play)
    session.play.transport.pause()


def test_moved_table_is_set_and_played(session: Session) -> None:
    at = INSTANCE.scene.placement(TOP).pose
    session.move(TOP, replace(at, y=at.y + 0.02))
    until_phase(session.play, Phase.READY)
    own = session.play.instance
    assert own is not None
    assert own.split == OWN_SPLIT
    assert own.scene.placement(TOP).pose.y == pytest.approx(at.y + 0.02)
    session.ask(replace(session.play.request), acts=True)
    until_phase(session.play, Phase.SOLVED)


def test_overlaps_are_reported_and_can_be_mended(session: Session) -> None:
    session.move(TOP, INSTANCE.scene.placement(BOTTOM).pose)
    until_phase(session.play, Phase.BROKEN)
    assert "overlap" in session.play.status.note
    session.move(TOP, FREE)
    until_phase(session.play, Phase.READY)
    session.take_listed()
    until_phase(session.play, Phase.READY)
    assert session.play.instance == INSTANCE


def test_gap_follows_the_robot_that_it_keeps_away() -> None:
    poke = load_instance("poke", "test", 0)
    for number, name in enumerate(poke.scene.robot_names):
        base = poke.scene.robots[number].base
        found = moved(poke, name, replace(base, x=base.x + 0.01))
        assert not any("gap" in told for told in problems(found))
    assert moved(poke, "robot_0", poke.scene.robots[0].base).scene == poke.scene


def test_thing_is_moved_while_an_episode_waits(session: Session) -> None:
    begin(session)
    session.move(TOP, FREE)
    play = session.play
    until(lambda: play.moved is not None)
    assert play.moved is not None
    assert not play.moved.problem
    assert any("You moved" in line.words for line in play.status.lines)
    found = rollout_of(play).episode.simulation.scene.pose2(TOP)
    assert found.distance(FREE) < 1e-3
    assert not play.transport.playing
    # The page shows the changed state.
    assert play.scene is not None
    play.transport.play()
    until(lambda: play.transport.cursor_s > 1.5, play)


@pytest.mark.parametrize(
    ("name", "pose", "says"),
    [
        (TOP, INSTANCE.scene.placement(BOTTOM).pose, "overlap"),
        (TOP, Pose2(0.0, 5.0), "does not lie on the table"),
        (PAD, FREE, "is fixed"),
    ],
)
def test_impossible_moves_are_undone(
    session: Session, name: str, pose: Pose2, says: str
) -> None:
    begin(session)
    play = session.play
    before = rollout_of(play).episode.simulation.scene.pose_row(name)
    session.move(name, pose)
    until(lambda: play.moved is not None)
    assert play.moved is not None
    assert says in play.moved.problem
    after = rollout_of(play).episode.simulation.scene.pose_row(name)
    assert after == pytest.approx(before, abs=1e-5)


def test_robots_stay_while_an_episode_goes_on(session: Session) -> None:
    begin(session)
    with pytest.raises(InvalidConfigError, match="or after an episode"):
        session.move("robot_0", FREE)
