"""Robots at work at the same time: the same goal sooner, and nobody gets in the way."""

import math
import os
import pickle
import random

import pytest
from recorded_episodes import first_instance, recorded
from small_tables import cube, facing, move
from tiers import slow_but
from watched_sectors import watch_sectors

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.env.snapshots import Ended
from lemma.expert.together import solve_together
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.reach import reach_of
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import SUITE, load_instance
from lemma.tasks.teams.dependencies import predecessors

ALONE = tuple(task for task in SUITE if task not in ("pass2", "stack2"))


PLANS = int(os.environ.get("TEAM_PLANS", "40"))
"""Random plans for each number of robots, in the slow tier."""


def test_a_sub_task_depends_on_earlier_ones_about_the_same_objects() -> None:
    steps = [
        SubTask("robot_0", Primitive.MOVE, "red_cube", "shared"),
        SubTask("robot_0", Primitive.MOVE, "blue_cube", "shared"),
        SubTask("robot_1", Primitive.MOVE, "red_cube", "red_pad"),
        SubTask("robot_1", Primitive.MOVE, "blue_cube", "red_cube"),
    ]
    needs = predecessors(steps, ("shared",))
    assert needs == ({}, {}, {0: "pick"}, {0: "place", 1: "pick", 2: "place"})


@pytest.mark.parametrize("task", slow_but(ALONE, "pass"))
def test_robots_that_begin_one_after_the_other_give_the_same_state(task: str) -> None:
    one_by_one = recorded(task, "ur5+ur10")
    episode = Episode(one_by_one.instance)
    for done in one_by_one.steps:
        episode.begin(done.grounded)
        while episode.simulation.busy:
            episode.advance(episode.simulation.time_s + 0.05)
    assert episode.simulation.scene.state_hash() == one_by_one.hashes[-1]
    episode.stop()
    assert episode.is_success


def test_a_robot_begins_when_what_it_needs_is_there() -> None:
    """In a relay nothing is parallel but the way home of the one before."""
    instance = load_instance("relay", "test", 0)
    episode = Episode(instance)
    watch = watch_sectors(episode.simulation)
    steps = list(solve_together(episode))
    assert episode.is_success
    ends = [step.start_s + step.result.duration_s for step in steps]
    starts = [step.start_s for step in steps]
    assert all(start < end - 0.5 for start, end in zip(starts[1:], ends, strict=False))
    assert watch.least_m > 0.05


@pytest.mark.parametrize("task", slow_but(("pass2", "stack2"), "stack2"))
def test_two_robots_at_once_are_sooner_and_keep_clear(task: str) -> None:
    one_by_one = recorded(task, "ur5+ur10")
    episode = Episode(one_by_one.instance)
    watch = watch_sectors(episode.simulation)
    steps = list(solve_together(episode))
    assert episode.is_success
    assert episode.elapsed_s < 0.9 * one_by_one.elapsed_s
    assert watch.least_m > 0.05
    assert [one.grounded for one in episode.executed] == [one.grounded for one in steps]


def test_a_moment_at_which_robots_are_busy_is_found_again_to_the_bit() -> None:
    instance = first_instance("stack2", "ur5+ur10")
    episode = Episode(instance)
    moments = []
    for _ in solve_together(episode):
        if episode.simulation.busy:
            found = episode.simulation.scene.state_hash(), tuple(episode.executed)
            moments.append((*found, episode.snapshot()))
    assert moments
    for state, executed, snapshot in moments:
        again = Episode(instance)
        again.restore(pickle.loads(pickle.dumps(snapshot)))
        assert again.simulation.scene.state_hash() == state
        assert tuple(again.executed) == executed
        assert again.snapshot().begun == snapshot.begun


@pytest.mark.slow
def test_what_follows_a_restored_moment_is_equal_to_the_bit() -> None:
    instance = first_instance("stack2", "ur5+ur10")
    plan = solve_together(Episode(instance))
    first = [one for one in plan if one.start_s == 0.0]
    endings = []
    for moment_s in (3.0, 6.0):
        team = Episode(instance)
        for one in first:
            team.begin(one.grounded)
        team.advance(moment_s)
        snapshot = team.snapshot()
        for played in (team, Episode(instance)):
            if played is not team:
                played.restore(snapshot)
            while played.simulation.busy:
                played.advance()
            waited = played.simulation.reservations.times
            state = played.simulation.scene.state_hash()
            endings.append((state, tuple(played.executed), waited))
    assert len(first) == 2
    assert all(ending == endings[0] for ending in endings)


def test_robots_that_wait_for_each_other_are_parted_by_a_retreat() -> None:
    """Each holds a cube where the other wants to put its own."""
    red, green = Pose2(-0.03, 0.22), Pose2(0.03, -0.22)
    simulation = Simulation(
        facing("ur5", cube("red", *red.xy), cube("green", *green.xy))
    )
    watch = watch_sectors(simulation)
    simulation.begin(move(red, Pose2(0.0, -0.1)))
    simulation.begin(move(green, Pose2(0.0, 0.1), "robot_1"))
    ended = [*simulation.advance(), *simulation.advance()]
    assert [one.result.outcome for one in ended] == ["success", "success"]
    assert simulation.reservations.times.retreats == 1
    assert simulation.reservations.cells == {}
    assert watch.least_m > 0.05


def ring(robots: int) -> SceneSpec:
    """Return some UR5 around a table, each with a cube, in a place that all sweep."""
    reach = reach_of("ur5").travel_m
    away = reach - 0.13 if robots < 4 else 0.66
    placed, cubes = [], []
    for k, color in enumerate(("red", "green", "blue", "white")[:robots]):
        angle = math.tau * k / robots
        base = Pose2(away * math.cos(angle), away * math.sin(angle), angle + math.pi)
        placed.append(RobotPlacement("ur5", ("red", "white")[k % 2], base))
        spot = base @ Pose2(0.35, -0.35)
        cubes.append(cube(color, spot.x, spot.y))
    return SceneSpec(tuple(placed), tuple(cubes))


def random_moves(spec: SceneSpec, seed: int, each: int) -> list[GroundedSubTask]:
    """Return moves of each robot's own cube to random free spots that it reaches.

    No spot is where the shoulder of an arm turns.
    """
    bases = [robot.base for robot in spec.robots]
    rng, sweep_m = random.Random(seed), sweep_radius_m("ur5") + 0.04
    found: list[GroundedSubTask] = []
    taken = [placed.pose for placed in spec.objects]
    at = list(taken)
    for _ in range(each):
        for k, robot in enumerate(spec.robots):
            reach = reach_of(robot.arm)
            while True:
                to = Pose2(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5))
                near = min(to.distance(other) for other in taken)
                free = near > 0.13 and min(map(to.distance, bases)) > sweep_m
                if free and reach.margin(robot.base, to.x, to.y) > 0.03:
                    break
            found.append(move(at[k], to, f"robot_{k}"))
            at[k] = to
            taken.append(to)
    return found


@pytest.mark.parametrize(
    ("robots", "seed"),
    slow_but(
        [
            (3, 0),
            (4, 0),
            *((robots, seed) for robots in (2, 3, 4) for seed in range(1, PLANS)),
        ],
        (3, 0),
    ),
)
def test_any_plan_ends_without_arms_that_touch(robots: int, seed: int) -> None:
    spec = ring(robots)
    simulation = Simulation(spec)
    watch = watch_sectors(simulation)
    todo, ended = random_moves(spec, seed, each=2), list[Ended]()
    while todo or simulation.busy:
        for name in spec.robot_names:
            mine = next((one for one in todo if one.robot == name), None)
            if name not in simulation.busy and mine is not None:
                todo.remove(mine)
                simulation.begin(mine, until_s=math.inf)
        ended += simulation.advance()
    assert len(ended) == 2 * robots
    assert simulation.reservations.times.retreats <= len(ended)
    assert watch.least_m > 0.02
    assert {one.result.outcome for one in ended} == {"success"}
