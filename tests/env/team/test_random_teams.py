"""Any valid orders, to two, three and four arms: all of them end, and no arms touch.

    RANDOM_TEAMS=1000 python -m pytest -m "" tests/env/team/test_random_teams.py

plays a thousand random plans.
"""

import os
import random
from dataclasses import replace

import pytest
from small_tables import cube, facing, move

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.team.orders import Team
from lemma.env.team.records import Done
from lemma.env.team.valid_orders import valid_options
from lemma.evaluation.run.watches import ClearanceWatch, ContactWatch
from lemma.motion import reservations
from lemma.motion.outcome import Outcome
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import load_instance

PLANS = int(os.environ.get("RANDOM_TEAMS", "40"))
"""Random plans, of which the first few are played by ``make test``."""
SOON = 2
TASKS = ("pass2", "sort", "carousel", "tower", "stack2", "line", "relay")
EACH = 2
"""Moves of each robot in a plan, as a mean."""


def order_by_chance(team: Team, rng: random.Random, most: int, *, stays: bool) -> int:
    """Give each free robot a valid order; return how many were given.

    Args:
        team: The robots.
        rng: Chance.
        most: So many orders at most.
        stays: Whether ``reach`` and ``lift`` are among them, after which arms stay
            over the table; all are moves otherwise.
    """
    now = team.observe()
    state, given = team.expected(now, team.settled(now)), 0
    for robot in team.free:
        every = valid_options(robot, state, team.grounder)
        options = [
            one for one in every if stays or one.subtask.primitive is Primitive.MOVE
        ]
        if options and given < most:
            option = rng.choice(options)
            assert team.order(option.subtask) is None
            state, given = option.after, given + 1
    return given


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(n, marks=() if n < SOON else pytest.mark.slow)
        for n in range(max(PLANS, SOON))
    ],
)
def test_random_valid_orders_all_end_and_no_arms_touch(number: int) -> None:
    """Every other plan has ``reach`` and ``lift`` as well."""
    task = TASKS[number % len(TASKS)]
    instance = load_instance(task, "train", number // len(TASKS))
    episode = Episode(instance)
    team, contacts = Team(episode), ContactWatch(episode.simulation)
    clearance = ClearanceWatch(episode.simulation)
    rng, left = random.Random(number), EACH * len(instance.scene.robots)
    ordered, ended = 0, list[Done]()
    while not episode.is_over and (left or team.orders):
        given = order_by_chance(team, rng, left, stays=bool(number % 2))
        if not given and not team.orders:
            break
        ordered, left = ordered + given, left - given
        ended += team.advance()
    assert ordered > 1
    assert len(ended) == ordered
    assert contacts.touched_s == 0.0
    assert clearance.least_m > 0.02
    assert not episode.is_thrown
    assert not episode.out_of_time


def crossed() -> tuple[Episode, Team]:
    """Return two robots, each ordered to put its cube where the other's hand is."""
    red, green = Pose2(-0.03, 0.22), Pose2(0.03, -0.22)
    scene = facing("ur5", cube("red", *red.xy), cube("green", *green.xy))
    goal = Goal.from_pairs((("red_cube", "green_cube"),))
    instance = replace(load_instance("stack2", "test", 0), scene=scene, goal=goal)
    episode = Episode(instance)
    team = Team(episode)
    for robot, pick, at, to in (
        ("robot_0", "red_cube", red, Pose2(0.0, -0.1)),
        ("robot_1", "green_cube", green, Pose2(0.0, 0.1)),
    ):
        subtask = SubTask(robot, Primitive.MOVE, pick, "shared")
        assert team.order(subtask, move(at, to, robot)) is None
    return episode, team


def test_orders_that_wait_for_each_others_sectors_are_parted_by_a_retreat() -> None:
    episode, team = crossed()
    ended = list[Done]()
    while team.orders:
        ended += team.advance()
    assert [done.result.outcome for done in ended] == ["success", "success"]
    assert episode.simulation.reservations.times.retreats == 1
    assert set(team.free) == {"robot_0", "robot_1"}


def test_an_order_that_waits_too_long_is_a_deadlock_and_frees_its_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reservations, "LONGEST_WAIT_S", 0.3)
    episode, team = crossed()
    ended = list[Done]()
    while team.orders:
        ended += team.advance()
    outcomes = {done.result.outcome for done in ended}
    assert Outcome.DEADLOCK in outcomes
    assert episode.simulation.reservations.times.deadlocks >= 1
    assert episode.elapsed_s < 30.0
    assert set(team.free) == {"robot_0", "robot_1"}
