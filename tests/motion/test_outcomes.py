"""Impossible sub-tasks end with an outcome and a reason, and leave a valid world."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from small_tables import (
    ARM_NAMES,
    assert_ready,
    cube,
    facing,
    move,
    pad,
    stick,
    stretch,
)
from tiers import slow_but

from lemma.core.poses import Pose, Pose2
from lemma.env.simulation import Simulation
from lemma.motion.outcome import Outcome, SkillResult
from lemma.motion.skills import SkillRunner
from lemma.planning.primitives import PRIMITIVES
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK
from lemma.tasks.subtask import GroundedSubTask, Primitive

FAR = Pose((1.2, 0.9, CUBE_EDGE_M / 2))
START = Pose2(-0.1, 0.15, 0.3)


def try_and_look(
    simulation: Simulation, subtask: GroundedSubTask, expected: Outcome
) -> SkillResult:
    """Execute what must fail; check that it is explained and leaves a valid world."""
    result = simulation.execute(subtask)
    assert result.outcome is expected, result.explanation
    assert not result.ok
    assert result.explanation.endswith(".")
    assert_ready(simulation)
    # The next sub-task goes well.
    name = next(n for n in simulation.scene.movable_names if n != STICK)
    simulation.observers.clear()
    simulation.scene.set_pose(name, Pose((*START.xy, CUBE_EDGE_M / 2)))
    simulation.rest(0.2)
    put = Pose2(-0.05, -0.15)
    assert simulation.execute(move(simulation.scene.pose2(name), put)).ok
    assert simulation.scene.pose2(name).distance(put) < 0.006
    return result


@pytest.fixture(params=slow_but(ARM_NAMES, "ur5"))
def simulation(request: pytest.FixtureRequest) -> Simulation:
    things = (
        cube("red", *START.xy, START.yaw),
        pad("green", -0.1, -0.35),
        stick(Pose2(-0.35, 0.35, 0.0)),
    )
    return Simulation(facing(request.param, *things))


def out_of_reach(simulation: Simulation) -> Pose2:
    spec = simulation.scene.spec.robots[0]
    return spec.base @ Pose2(reach_of(spec.arm).grasp_m + 0.02, 0.0)


def test_a_cube_out_of_reach_is_unreachable(simulation: Simulation) -> None:
    far = out_of_reach(simulation)
    simulation.scene.set_pose("red_cube", Pose((far.x, far.y, 0.025)))
    before = simulation.time_s
    result = try_and_look(simulation, move(far, START), Outcome.UNREACHABLE)
    arm = simulation.arms["robot_0"].robot.arm.name
    assert f"robot_0 ({arm}) cannot reach the pick position" in result.explanation
    assert f"({far.x:.3f}, {far.y:.3f})" in result.explanation
    # It is known before anything moves.
    assert result.duration_s < 0.2
    assert before == 0.0


def test_a_place_out_of_reach_is_unreachable(simulation: Simulation) -> None:
    far = out_of_reach(simulation)
    result = try_and_look(simulation, move(START, far), Outcome.UNREACHABLE)
    assert "cannot reach the place position" in result.explanation


def test_what_can_be_touched_but_not_lifted_is_unreachable(
    simulation: Simulation,
) -> None:
    """At the rim of the ring the arm reaches the table, but not travel height."""
    spec = simulation.scene.spec.robots[0]
    reach = reach_of(spec.arm)
    rim = spec.base @ Pose2(0.5 * (reach.travel_m + reach.grasp_m), 0.0)
    simulation.scene.set_pose("red_cube", Pose((rim.x, rim.y, 0.025)))
    result = try_and_look(simulation, move(rim, START), Outcome.UNREACHABLE)
    assert "at height 0.30 m" in result.explanation


@pytest.mark.parametrize(
    ("at", "what"),
    [((-0.1, 0.0), "the bare table"), ((-0.1, -0.35), "green_pad")],
)
def test_there_is_nothing_to_pick(
    simulation: Simulation, at: tuple[float, float], what: str
) -> None:
    result = try_and_look(simulation, move(Pose2(*at), START), Outcome.NOTHING_TO_PICK)
    assert f"{what} is there" in result.explanation
    assert f"({at[0]:.3f}, {at[1]:.3f})" in result.explanation


@pytest.mark.parametrize("primitive", [p for p in Primitive if PRIMITIVES[p].tool])
def test_a_cube_is_no_tool(simulation: Simulation, primitive: Primitive) -> None:
    wrong = replace(move(START, Pose2(-0.1, 0.0)), primitive=primitive)
    result = try_and_look(simulation, wrong, Outcome.INVALID)
    assert f"{primitive} needs the stick" in result.explanation
    assert "red_cube" in result.explanation


def take_away(simulation: Simulation, when: Callable[[], bool]) -> None:
    """Let somebody snatch the cube away at some moment."""
    taken: list[bool] = []

    def look() -> None:
        if not taken and when():
            taken.append(True)
            simulation.scene.set_pose("red_cube", FAR)

    simulation.observers.append(look)


def test_fingers_that_close_on_nothing_miss_the_grasp(simulation: Simulation) -> None:
    arm = simulation.arms["robot_0"]
    take_away(simulation, lambda: arm.opening_m == 0.0)
    subtask = move(START, Pose2(-0.1, -0.1))
    result = try_and_look(simulation, subtask, Outcome.MISSED_GRASP)
    assert "robot_0" in result.explanation


@pytest.mark.parametrize("height_m", [0.1, 0.25])
def test_what_is_lost_on_the_way_was_dropped(
    simulation: Simulation, height_m: float
) -> None:
    take_away(
        simulation,
        lambda: simulation.scene.pose("red_cube").position[2] > height_m,
    )
    subtask = move(START, Pose2(-0.1, -0.1))
    result = try_and_look(simulation, subtask, Outcome.DROPPED)
    assert "robot_0" in result.explanation


def park(simulation: Simulation) -> None:
    arm = simulation.arms["robot_1"]
    simulation.scene.set_joints(arm.robot, arm.park, FINGER_OPENING_M)
    arm.sync()
    arm.follow_posture(arm.park)
    simulation.rest(0.2)


@pytest.mark.parametrize("arm", slow_but(ARM_NAMES, "ur10"))
def test_an_arm_over_the_cube_is_a_collision(arm: str) -> None:
    simulation = Simulation(facing(arm, cube("red", 0.05, 0.0)))
    stretch(simulation, (0.05, 0.0, 0.12))
    subtask = move(Pose2(0.05, 0.0), Pose2(-0.05, 0.35))
    result = simulation.execute(subtask)
    assert result.outcome is Outcome.COLLISION
    assert "robot_0 is blocked on its way to (0.050, 0.000" in result.explanation
    park(simulation)
    assert_ready(simulation)
    assert simulation.scene.pose2("red_cube").distance(subtask.pick) < 1e-3
    assert simulation.execute(subtask).ok
    assert simulation.scene.pose2("red_cube").distance(subtask.place) < 0.006


@pytest.mark.parametrize("arm", slow_but(ARM_NAMES, "ur5"))
def test_an_arm_that_bars_the_way_costs_the_time(arm: str) -> None:
    simulation = Simulation(facing(arm, cube("red", -0.2, -0.4)))
    stretch(simulation, (-0.05, 0.05, 0.3))
    subtask = move(Pose2(-0.2, -0.4), Pose2(-0.05, 0.35))
    result = simulation.execute(subtask)
    assert result.outcome is Outcome.TIMEOUT
    assert "robot_0" in result.explanation
    assert 7.0 < result.duration_s < 20.0
    park(simulation)
    assert_ready(simulation)
    # It was let go on the way, and lies somewhere else.
    fallen = move(simulation.scene.pose2("red_cube"), subtask.place)
    assert simulation.execute(fallen).ok


def test_two_arms_that_run_into_each_other_notice() -> None:
    simulation = Simulation(facing("ur5", cube("red", 0.0, 0.0)))
    other = simulation.arms["robot_1"]
    posture = other.solve_posture(top_down(0.0, 0.0, 0.12, 0.0))
    assert posture is not None
    skill = SkillRunner(simulation.arms).run(move(Pose2(0.0, 0.0), START))
    other.follow_posture(posture)
    result = None
    for _ in range(4000):
        try:
            next(skill)
        except StopIteration as end:
            result = end.value
            break
        simulation.tick(("robot_0", "robot_1"))
    assert result is not None
    assert result.outcome is Outcome.COLLISION
    assert "robot_0" in result.explanation


@pytest.mark.parametrize("until_s", [0.5, 3.0, 5.0])
def test_the_end_of_the_episode_breaks_off(
    simulation: Simulation, until_s: float
) -> None:
    result = simulation.execute(move(START, Pose2(-0.1, -0.1)), until_s=until_s)
    assert result.outcome is Outcome.OUT_OF_TIME
    assert not result.ok
    assert f"ended at {until_s:g} s" in result.explanation
    assert simulation.time_s == pytest.approx(until_s)
    assert result.duration_s == pytest.approx(until_s)
