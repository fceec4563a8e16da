"""Plays in which all robots act at once: the expert's, and visitors' orders."""

from collections.abc import Iterator

import pytest
from looked_at import player_of, rollout_of, session_of, until
from recorded_episodes import INDEX, acted_together

from lemma.core.poses import Pose2
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import load_instance
from lemma.viewer.episode.session import best_for, choices
from lemma.viewer.episode.status import TOGETHER, EpisodeRequest, Phase
from lemma.viewer.episode.team_play import TeamPlay
from lemma.viewer.words import chart_html, order_words, team_html
from lemma.viz.gantt import Cause, spans_of

CAROUSEL = EpisodeRequest("carousel", "test", INDEX, policy=TOGETHER)
INSTANCE = load_instance("carousel", "test", INDEX)


@pytest.fixture
def play() -> Iterator[TeamPlay]:
    found = TeamPlay(CAROUSEL, player_of(), acts=True, speed=8.0)
    yield found
    found.leave(20.0)


def options_of(play: TeamPlay, robot: str) -> tuple[SubTask, ...]:
    """Ask what a robot could be ordered, while the episode stands still."""
    play.look_for_options(robot)
    until(lambda: play.options is not None and play.options.robot == robot)
    assert play.options is not None
    return play.options.subtasks


@pytest.mark.slow
def test_expert_acts_as_it_does_alone(play: TeamPlay) -> None:
    until(lambda: play.wait(0.0), play)
    assert play.status.phase is Phase.SOLVED
    alone = acted_together("carousel")
    steps = {(str(step.subtask), step.start_s) for step in alone.steps}
    assert {(str(line.subtask), line.start_s) for line in play.status.lines} == steps
    seen = rollout_of(play).episode.simulation.scene.state_hash()
    assert seen == alone.state_sha256
    spans = spans_of(INSTANCE, play.status.lines, rollout_of(play).episode.elapsed_s)
    assert {Cause.BUSY, Cause.REGION, Cause.PREDECESSOR} <= {s.cause for s in spans}


@pytest.mark.slow
def test_robot_is_taken_ordered_and_handed_back_while_others_move(
    play: TeamPlay,
) -> None:
    robot = INSTANCE.scene.robot_names[0]
    until(lambda: play.takes_orders and len(play.status.lines) == 4, play)
    play.take(robot)
    assert "(yours)" in team_html(play)
    others = (line.subtask for line in play.status.lines)
    assert {one.robot for one in others if one} == set(INSTANCE.scene.robot_names)

    def is_free() -> bool:
        lines = [line for line in play.status.lines if line.subtask]
        return all(
            line.end_s is not None
            for line in lines
            if line.subtask and line.subtask.robot == robot
        )

    until(is_free, play)
    before = len(play.status.lines)
    # In a pause, too, since a visitor wants to think.
    wanted = options_of(play, robot)
    assert all(subtask.robot == robot for subtask in wanted)
    order = wanted[-1]
    assert order not in play.todo
    play.order(order)

    def begun() -> list[SubTask | None]:
        lines = play.status.lines[before:]
        return [one.subtask for one in lines if one.subtask]

    until(lambda: order in begun(), play)
    mine = [one for one in begun() if one and one.robot == robot]
    assert mine == [order]
    busy = [line for line in play.status.lines if line.end_s is None]
    assert len(busy) > 1
    play.give_back(robot)
    assert robot not in play.visitor_led
    until(lambda: play.wait(0.0), play)
    assert play.status.phase is Phase.SOLVED


@pytest.mark.slow
def test_expert_waits_for_the_visitor_who_has_taken_all(play: TeamPlay) -> None:
    until(lambda: len(play.status.lines) == 4, play)
    for robot in INSTANCE.scene.robot_names:
        play.take(robot)
    until(lambda: all(line.end_s for line in play.status.lines), play)
    simulation = rollout_of(play).episode.simulation
    now_s = simulation.time_s
    until(lambda: simulation.time_s > now_s + 2.0, play)
    assert len(play.status.lines) == 4
    assert not play.transport.over
    for robot in INSTANCE.scene.robot_names:
        play.give_back(robot)
    until(lambda: play.wait(0.0), play)
    assert play.status.phase is Phase.SOLVED


@pytest.mark.slow
def test_expert_plans_anew_when_a_cube_is_moved(play: TeamPlay) -> None:
    def fetched_next() -> list[str]:
        """Return cubes that somebody has put down for another robot."""
        lines = [(line.subtask, line.end_s) for line in play.status.lines]
        at_work = {step.pick for step, end_s in lines if step and not end_s}
        put_down = {step.pick for step, end_s in lines if step and end_s}
        return [s.pick for s in play.todo if s.pick in put_down - at_work]

    until(lambda: bool(fetched_next()), play)
    (cube, *_) = fetched_next()
    now = SymbolicState.observe(rollout_of(play).episode.simulation.scene)
    at = now.poses[cube]
    play.nudge(cube, Pose2(at.x, at.y, at.yaw + 0.5))
    until(lambda: play.moved is not None)
    play.transport.play()
    until(lambda: play.wait(0.0), play)
    assert play.status.phase is Phase.SOLVED
    assert any(line.outcome == "by hand" for line in play.status.lines)


def test_session_offers_it_and_begins_teams_with_it() -> None:
    assert TOGETHER in choices()
    assert best_for("carousel", choices()) == TOGETHER
    assert best_for("stack", choices()) == choices()[0]
    session = session_of(CAROUSEL, **{TOGETHER: None})
    assert isinstance(session.play, TeamPlay)
    session.close()


@pytest.mark.slow
def test_words_name_robots_by_color_not_by_number(play: TeamPlay) -> None:
    until(lambda: play.transport.end_s > 1.0, play)
    said = [line.words for line in play.status.lines]
    assert "red robot: move the red cube to the space of red and white" in said
    subtask = play.status.lines[0].subtask
    assert subtask is not None
    assert order_words(subtask, INSTANCE) == said[0].partition(": ")[2]
    chart = chart_html(play, 0.0)
    assert chart.count('data-cause="at work"') >= 4
    assert "&lt;" not in chart
