"""Every primitive does what it says; what cannot be done ends typed and explained."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lemma.core.errors import UnknownNameError
from lemma.core.poses import Pose, Pose2, wrap
from lemma.env.simulation import Simulation
from lemma.motion.outcome import Outcome, SkillResult
from lemma.motion.skills import SkillRunner
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.kinematics import top_down
from lemma.robots.reach import reach_of
from lemma.scene.objects import CUBE_EDGE_M, PAD_THICKNESS_M
from lemma.scene.spec import STICK, ObjectPlacement
from lemma.tasks.subtask import GroundedSubTask, Primitive
from lemma.tasks.tool_use import (
    Drag,
    find_drag,
    grasp_on_stick,
    is_prepared,
    stick_in_grasp,
)
from small_tables import ARM_NAMES, cube, facing, pad, stick

FAR = Pose((1.2, 0.9, CUBE_EDGE_M / 2))
START = Pose2(-0.1, 0.15, 0.3)


def move(pick: Pose2, place: Pose2, robot: str = "robot_0") -> GroundedSubTask:
    return GroundedSubTask(robot, Primitive.MOVE, pick, place)


def assert_ready(simulation: Simulation, robot: str = "robot_0") -> None:
    """The world is valid: every arm parked, grippers open, nothing held or flying."""
    scene = simulation.scene
    assert simulation.held() == {}
    for arm in simulation.arms.values():
        assert np.abs(scene.data.qpos[arm.robot.qpos] - arm.park).max() < 0.06
        assert arm.opening_m == FINGER_OPENING_M
    opening = scene.opening_m(simulation.arms[robot].robot)
    assert opening == pytest.approx(FINGER_OPENING_M, abs=0.002)
    assert np.isfinite(scene.snapshot()).all()
    simulation.rest(0.3)
    for name in scene.movable_names:
        assert scene.speed(name) < 0.02
        assert scene.pose(name).position[2] > 0.01


def assert_at(simulation: Simulation, name: str, pose: Pose2, z: float) -> None:
    found = simulation.scene.pose2(name)
    assert found.distance(pose) < 0.006
    # A square looks the same after quarter turns.
    period = math.pi / 2 if name.endswith("_cube") else math.tau
    off = (found.yaw - pose.yaw + period / 2) % period - period / 2
    assert abs(off) < 0.04
    assert simulation.scene.pose(name).position[2] == pytest.approx(z, abs=0.002)


# --- Move --------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ARM_NAMES)
@pytest.mark.parametrize("robot", ["robot_0", "robot_1"])
def test_move_puts_a_cube_where_it_says(arm: str, robot: str) -> None:
    simulation = Simulation(facing(arm, cube("red", 0.0, 0.1, 0.3)))
    start, end = Pose2(0.0, 0.1, 0.3), Pose2(0.05, -0.2, 1.1)
    before = simulation.time_s
    result = simulation.execute(move(start, end, robot))
    assert result.ok
    assert result.outcome is Outcome.SUCCESS
    assert result.duration_s == pytest.approx(simulation.time_s - before)
    assert simulation.clocks[robot].busy_s == pytest.approx(result.duration_s)
    assert_at(simulation, "red_cube", end, CUBE_EDGE_M / 2)
    assert_ready(simulation, robot)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_move_puts_a_cube_on_a_pad_and_on_a_cube(arm: str) -> None:
    simulation = Simulation(
        facing(
            arm,
            cube("red", -0.1, 0.15),
            cube("blue", -0.1, -0.1),
            pad("green", 0.0, 0.3),
        )
    )
    onto_pad = move(Pose2(-0.1, 0.15), Pose2(0.0, 0.3))
    assert simulation.execute(onto_pad).ok
    height = PAD_THICKNESS_M + CUBE_EDGE_M / 2
    assert_at(simulation, "red_cube", Pose2(0.0, 0.3), height)
    onto_cube = move(Pose2(-0.1, -0.1), simulation.scene.pose2("red_cube"))
    assert simulation.execute(onto_cube).ok
    assert_at(simulation, "blue_cube", Pose2(0.0, 0.3), height + CUBE_EDGE_M)
    assert_at(simulation, "red_cube", Pose2(0.0, 0.3), height)
    # From the top of the tower as well, by the height of what the ray meets first.
    back = move(simulation.scene.pose2("blue_cube"), Pose2(-0.1, -0.1))
    assert simulation.execute(back).ok
    assert_at(simulation, "blue_cube", Pose2(-0.1, -0.1), CUBE_EDGE_M / 2)
    assert_ready(simulation)


def test_move_lifts_to_travel_height() -> None:
    simulation = Simulation(facing("ur5", cube("red", *START.xy, START.yaw)))
    heights = []
    simulation.observers.append(
        lambda: heights.append(simulation.scene.pose("red_cube").position[2])
    )
    simulation.execute(move(START, Pose2(-0.1, -0.2)))
    assert 0.25 < max(heights) < 0.36


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_move_carries_the_stick(arm: str) -> None:
    lying = Pose2(-0.15, -0.2, 0.5)
    simulation = Simulation(facing(arm, stick(lying)))
    place = Pose2(-0.1, 0.1, 0.2)
    assert simulation.execute(move(grasp_on_stick(lying), place)).ok
    assert_at(simulation, STICK, stick_in_grasp(place), 0.015)
    assert_ready(simulation)


@pytest.mark.parametrize("turn", [0, 1])
def test_half_a_turn_of_the_gripper_makes_no_difference(turn: int) -> None:
    simulation = Simulation(facing("ur5", cube("red", *START.xy, START.yaw)))
    end = Pose2(-0.05, -0.2, 0.9)
    half = turn * math.pi
    turned = move(
        Pose2(*START.xy, START.yaw + half), Pose2(end.x, end.y, end.yaw + half)
    )
    assert simulation.execute(turned).ok
    assert_at(simulation, "red_cube", end, CUBE_EDGE_M / 2)
    # The cube turned by place minus pick, not by half a turn more or less.
    yaw = simulation.scene.pose2("red_cube").yaw
    assert abs(wrap(yaw - START.yaw - (end.yaw - START.yaw))) < 0.04


# --- Hook and poke -----------------------------------------------------------------


def drag_for(
    primitive: Primitive, arm: str
) -> tuple[Drag, ObjectPlacement, ObjectPlacement, float]:
    """A cube out of reach, the stick, and how one is dragged with the other."""
    # Poking bridges a gap, hooking needs none.
    gap = 0.1 if primitive is Primitive.POKE else -0.25
    spec = facing(arm, gap_m=gap)
    robot = spec.robots[0]
    receiver = spec.robots[0 if primitive is Primitive.HOOK else 1]
    reach = reach_of(arm)
    ahead = robot.base @ Pose2(reach.grasp_m + 0.04, -0.05, 0.4)
    drag = find_drag(
        primitive,
        robot,
        ahead,
        lambda x, y: reach.margin(receiver.base, x, y),
        [],
    )
    assert drag is not None
    lying = robot.base @ Pose2(0.6 * reach.travel_m, 0.3, 0.5)
    return drag, cube("red", ahead.x, ahead.y, ahead.yaw), stick(lying), gap


@pytest.mark.parametrize("arm", ARM_NAMES)
@pytest.mark.parametrize(
    ("prepare", "use"),
    [(Primitive.PREHOOK, Primitive.HOOK), (Primitive.PREPOKE, Primitive.POKE)],
)
def test_tools_are_put_down_ready_and_then_used(
    arm: str, prepare: Primitive, use: Primitive
) -> None:
    drag, target, tool, gap = drag_for(use, arm)
    simulation = Simulation(facing(arm, target, tool, gap_m=gap))
    scene = simulation.scene
    start = scene.pose2("red_cube")
    ready = GroundedSubTask(
        "robot_0", prepare, grasp_on_stick(tool.pose), drag.prepared
    )
    assert simulation.execute(ready).ok
    assert_at(simulation, STICK, stick_in_grasp(drag.prepared), 0.015)
    assert scene.pose2("red_cube").distance(start) < 1e-3
    assert is_prepared(use, scene.pose2(STICK), scene.pose2("red_cube"))
    assert_ready(simulation)
    heights: list[float] = []
    simulation.observers.append(lambda: heights.append(scene.pose(STICK).position[2]))
    pick = grasp_on_stick(scene.pose2(STICK))
    assert simulation.execute(GroundedSubTask("robot_0", use, pick, drag.end)).ok
    assert_ready(simulation)
    assert scene.pose2("red_cube").distance(drag.cube) < 0.02
    assert scene.pose("red_cube").position[2] == pytest.approx(0.025, abs=0.002)
    # Low: the stick hovers, it is not carried.
    assert max(heights) < 0.05
    # Fingers fit around the cube, away from the stick.
    near = scene.pose2(STICK).inverse() @ scene.pose2("red_cube")
    assert near.x < 0.47 - 0.025 - 0.02 or near.x > 0.5 + 0.025 + 0.02
    base = simulation.scene.spec.robots[0 if use is Primitive.HOOK else 1].base
    assert reach_of(arm).margin(base, *scene.pose2("red_cube").xy) > 0.02


# --- What cannot be done -----------------------------------------------------------


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


@pytest.fixture(params=ARM_NAMES)
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


@pytest.mark.parametrize(
    "primitive", [p for p in Primitive if p not in (Primitive.MOVE, Primitive.STOP)]
)
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


def stretch(simulation: Simulation, at: tuple[float, float, float]) -> None:
    """Let the other robot stand in the way."""
    arm = simulation.arms["robot_1"]
    posture = arm.solve_posture(top_down(*at, 0.0))
    assert posture is not None
    simulation.scene.set_joints(arm.robot, posture, FINGER_OPENING_M)
    arm.sync()
    arm.follow_posture(posture)
    simulation.rest(0.2)


def park(simulation: Simulation) -> None:
    arm = simulation.arms["robot_1"]
    simulation.scene.set_joints(arm.robot, arm.park, FINGER_OPENING_M)
    arm.sync()
    arm.follow_posture(arm.park)
    simulation.rest(0.2)


@pytest.mark.parametrize("arm", ARM_NAMES)
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
    assert_at(simulation, "red_cube", subtask.place, CUBE_EDGE_M / 2)


@pytest.mark.parametrize("arm", ARM_NAMES)
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
    assert simulation.execute(subtask).ok


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


def test_a_robot_that_does_not_exist_is_answered(simulation: Simulation) -> None:
    with pytest.raises(UnknownNameError, match=r"'robot_2'.*Valid: robot_0, robot_1"):
        simulation.execute(move(START, START, "robot_2"))
    assert simulation.execute(move(START, Pose2(-0.1, 0.0))).ok


# --- The ray that stands for a depth camera ----------------------------------------


def test_surface_is_the_height_of_what_lies_there() -> None:
    simulation = Simulation(
        facing(
            "ur5",
            cube("red", 0.0, 0.0),
            cube("blue", 0.3, 0.3),
            pad("green", 0.0, 0.3),
            stick(Pose2(-0.3, -0.3)),
        )
    )
    runner, scene = SkillRunner(simulation.arms), simulation.scene
    scene.set_pose("blue_cube", Pose((0.0, 0.0, 0.075)))

    def seen(x: float, y: float, exclude: int = -1) -> tuple[float, str | None]:
        height, entity = runner.surface(Pose2(x, y), exclude)
        return round(height, 3), entity

    assert seen(0.0, 0.0) == (0.1, "blue_cube")
    assert seen(0.024, 0.024) == (0.1, "blue_cube")
    assert seen(0.027, 0.0) == (0.0, None)
    assert seen(0.0, 0.0, scene.model.body("blue_cube").id) == (0.05, "red_cube")
    assert seen(0.05, 0.3) == (0.004, "green_pad")
    assert seen(0.0, -0.3) == (0.03, "stick")
    assert seen(0.185, -0.2) == (0.03, "stick")
    assert seen(0.1, -0.2) == (0.0, None)


def test_surface_looks_through_robots(simulation: Simulation) -> None:
    runner = SkillRunner(simulation.arms)
    stretch(simulation, (*START.xy, 0.2))
    height, entity = runner.surface(START)
    assert (round(height, 3), entity) == (0.05, "red_cube")
    base = simulation.scene.spec.robots[0].base
    assert runner.surface(base) == (0.0, None)
