"""An arm that stays over the table holds its sector, and makes way for others."""

import pickle
from dataclasses import replace

import pytest
from small_tables import cube, facing, move
from watched_sectors import watch_sectors

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.env.snapshots import Ended
from lemma.motion.arm_motion import largest_turn
from lemma.motion.staying import HOME_RAD
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import GroundedSubTask, Primitive
from lemma.tasks.suite import load_instance

RED, GREEN, BEYOND = Pose2(-0.03, 0.0), Pose2(0.15, 0.3), Pose2(0.05, -0.25)
TABLE = facing("ur5", cube("red", *RED.xy), cube("green", *GREEN.xy))
ACROSS = move(GREEN, BEYOND, "robot_1")
"""The arm sweeps over the red cube."""


def hand(primitive: Primitive) -> GroundedSubTask:
    return GroundedSubTask("robot_0", primitive, RED, RED)


def is_home(simulation: Simulation, robot: str) -> bool:
    arm = simulation.arms[robot]
    return largest_turn(arm.measured, arm.park) < HOME_RAD


@pytest.mark.parametrize("primitive", [Primitive.REACH, Primitive.LIFT])
def test_an_arm_over_the_table_goes_home_when_another_must_pass(
    primitive: Primitive,
) -> None:
    simulation = Simulation(TABLE)
    watch = watch_sectors(simulation)
    simulation.begin(hand(primitive))
    simulation.begin(ACROSS)
    ended = [*simulation.advance(), *simulation.advance()]
    assert [one.result.outcome for one in ended] == ["success", "success"]
    assert is_home(simulation, "robot_0")
    assert simulation.held() == ({"robot_0": "red_cube"} if primitive == "lift" else {})
    assert simulation.reservations.cells == {}
    assert not simulation.scene.coasting.is_thrown
    assert watch.least_m > 0.05


def test_an_arm_that_has_stayed_since_before_holds_its_sector_as_well() -> None:
    simulation = Simulation(TABLE)
    assert simulation.execute(hand(Primitive.REACH)).ok
    assert not is_home(simulation, "robot_0")
    watch = watch_sectors(simulation)
    simulation.begin(ACROSS)
    (ended,) = simulation.advance()
    assert ended.result.ok
    assert is_home(simulation, "robot_0")
    assert watch.least_m > 0.05


def test_nobody_makes_way_where_robots_take_turns() -> None:
    simulation = Simulation(TABLE)
    assert simulation.execute(hand(Primitive.LIFT)).ok
    simulation.execute(ACROSS)
    assert simulation.held() == {"robot_0": "red_cube"}
    assert not is_home(simulation, "robot_0")
    assert simulation.reservations.times.waited_s == {}


def test_an_arm_that_makes_way_can_begin_to_work() -> None:
    simulation = Simulation(TABLE)
    watch = watch_sectors(simulation)
    simulation.execute(hand(Primitive.LIFT))
    simulation.begin(ACROSS)
    simulation.advance(simulation.time_s + 1.0)
    simulation.begin(hand(Primitive.REACH))
    ended = list(simulation.advance())
    while simulation.busy:
        ended += simulation.advance()
    assert len(ended) == 2
    assert watch.least_m > 0.05


def test_a_moment_in_which_an_arm_makes_way_is_found_again_to_the_bit() -> None:
    goal = Goal.from_pairs((("red_cube", "green_cube"),))
    instance = replace(load_instance("stack2", "test", 0), scene=TABLE, goal=goal)
    first, again = Episode(instance), Episode(instance)
    first.execute(hand(Primitive.LIFT))
    first.begin(ACROSS)
    first.advance(first.simulation.time_s + 1.2)
    again.restore(pickle.loads(pickle.dumps(first.snapshot())))
    for episode in (first, again):
        while episode.simulation.busy:
            episode.advance()
    found = [one.simulation.scene.state_hash() for one in (first, again)]
    assert found[0] == found[1]
    assert is_home(first.simulation, "robot_0")


def test_what_a_hand_still_holds_is_put_down_while_others_work() -> None:
    simulation = Simulation(TABLE)
    simulation.begin(hand(Primitive.LIFT))
    simulation.advance()
    simulation.begin(move(GREEN, Pose2(0.3, 0.25), "robot_1"))
    simulation.begin(move(RED, Pose2(-0.15, 0.1)))
    ended = [*simulation.advance(), *simulation.advance()]
    assert [one.result.outcome for one in ended] == ["success", "success"]
    assert not simulation.scene.coasting.is_thrown


def test_a_load_is_put_down_when_a_late_robot_has_cleared_its_place() -> None:
    simulation = Simulation(TABLE)
    watch = watch_sectors(simulation)
    paces = {"robot_0": 0.25}
    simulation.pace = lambda robot, start_s, now_s: paces.get(robot, 1.0)
    simulation.begin(move(RED, Pose2(-0.2, -0.2)))
    simulation.begin(move(GREEN, RED, "robot_1"), leaving={"red_cube": "robot_0"})
    ended = list[Ended]()
    while simulation.busy:
        ended += simulation.advance()
    assert [one.result.outcome for one in ended] == ["success", "success"]
    z_m = simulation.scene.position("green_cube")[2]
    assert z_m == pytest.approx(kind_of("green_cube").origin_m, abs=0.002)
    assert watch.least_m > 0.05
