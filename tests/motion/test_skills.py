"""Every primitive does what it says."""

import math
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

from lemma.core.poses import Pose, Pose2, wrap
from lemma.env.simulation import Simulation
from lemma.motion.outcome import Outcome
from lemma.motion.skills import SkillRunner
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.pad import PAD_THICKNESS_M
from lemma.scene.objects.stick import HANDLE_LENGTH_M, STICK_SECTION_M
from lemma.scene.spec import ObjectPlacement
from lemma.tasks.drags import (
    Drag,
    find_drag,
    grasp_on_stick,
    is_prepared,
    stick_in_grasp,
)
from lemma.tasks.subtask import GroundedSubTask, Primitive

START = Pose2(-0.1, 0.15, 0.3)


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


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_move_carries_the_stick(arm: str) -> None:
    lying = Pose2(-0.15, -0.2, 0.5)
    simulation = Simulation(facing(arm, stick(lying)))
    place = Pose2(-0.1, 0.1, 0.2)
    assert simulation.execute(move(grasp_on_stick(lying), place)).ok
    assert_at(simulation, STICK, stick_in_grasp(place), 0.015)
    assert_ready(simulation)


def test_half_a_turn_of_the_gripper_makes_no_difference_at_travel_height() -> None:
    simulation = Simulation(facing("ur5", cube("red", *START.xy, START.yaw)))
    end = Pose2(-0.05, -0.2, 0.9)
    heights: list[float] = []
    simulation.observers.append(
        lambda: heights.append(simulation.scene.pose("red_cube").position[2])
    )
    turned = move(replace(START, yaw=0.3 + math.pi), replace(end, yaw=0.9 + math.pi))
    assert simulation.execute(turned).ok
    assert 0.25 < max(heights) < 0.36
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
    could, reach = could_of(arm), reach_of(arm)
    gap = 2.0 * (could.touch_m - reach.travel_m) + 0.13
    if primitive is Primitive.HOOK:
        gap = -0.25
    spec = facing(arm, gap_m=gap)
    robot = spec.robots[0]
    receiver = spec.robots[0 if primitive is Primitive.HOOK else 1]
    # Where nobody could touch it: hooked from one side, for that is free of the other.
    bearing = 0.0 if primitive is Primitive.POKE else 1.2
    away = could.touch_m + 0.065
    ahead = robot.base @ Pose2(away * math.cos(bearing), away * math.sin(bearing), 0.4)
    drag = find_drag(primitive, robot, receiver, ahead, [])
    assert drag is not None
    lying = robot.base @ Pose2(0.5 * reach.travel_m, -0.3, -0.5)
    return drag, cube("red", ahead.x, ahead.y, ahead.yaw), stick(lying), gap


@pytest.mark.parametrize("arm", slow_but(ARM_NAMES, "ur5"))
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
    inner, outer = HANDLE_LENGTH_M - STICK_SECTION_M, HANDLE_LENGTH_M
    assert near.x < inner - 0.025 - 0.02 or near.x > outer + 0.025 + 0.02
    # And it is where its user can pick it up again.
    left, user = grasp_on_stick(scene.pose2(STICK)), simulation.scene.spec.robots[0]
    assert reach_of(arm).margin(user.base, *left.xy) > 0.005
    assert left.distance(drag.left) < 0.04
    base = simulation.scene.spec.robots[0 if use is Primitive.HOOK else 1].base
    assert reach_of(arm).margin(base, *scene.pose2("red_cube").xy) > 0.02


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
    assert seen(0.05, 0.3) == (PAD_THICKNESS_M, "green_pad")
    assert seen(0.0, -0.3) == (0.03, "stick")
    assert seen(0.435, -0.2) == (0.03, "stick")
    assert seen(0.35, -0.2) == (0.0, None)


@pytest.mark.parametrize("arm", ARM_NAMES)
def test_surface_looks_through_robots(arm: str) -> None:
    simulation = Simulation(facing(arm, cube("red", *START.xy)))
    runner = SkillRunner(simulation.arms)
    stretch(simulation, (*START.xy, 0.2))
    height, entity = runner.surface(START)
    assert (round(height, 3), entity) == (0.05, "red_cube")
    base = simulation.scene.spec.robots[0].base
    assert runner.surface(base) == (0.0, None)
