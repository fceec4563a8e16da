"""A pushed cube does not climb a pad, and one that is dragged into a gap falls."""

import math
from contextlib import suppress

import pytest
from small_tables import cube, facing, pad, stick
from tiers import slow_but

from lemma.core.poses import Pose2
from lemma.env.simulation import Simulation
from lemma.motion.moves import Motion, Moves, Stand
from lemma.motion.outcome import SkillFailure
from lemma.motion.skills import DRAG_HEIGHT_M, stand_at
from lemma.robots.could import could_of
from lemma.scene.objects.cube import CUBE, CUBE_EDGE_M
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.pad import PAD_RADIUS_M, PAD_THICKNESS_M
from lemma.scene.objects.stick import (
    HANDLE_LENGTH_M,
    HOOK_LENGTH_M,
    STICK_GRASP_HEIGHT_M,
    STICK_SECTION_M,
)
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.scene.table import FLOOR_Z_M
from lemma.tasks.drags import find_drag, grasp_on_stick
from lemma.tasks.goal import On
from lemma.tasks.subtask import GroundedSubTask, Primitive

ARM = "ur10"
BASE = facing(ARM).robots[0].base
AWAY_M = 1.15
BEFORE_M = 0.12
"""From the pad's middle to the cube's before it is pushed."""


def carry_out(simulation: Simulation, motion: Motion) -> bool:
    """Move the first arm; return whether cube and pad touched meanwhile.

    An arm that is held up gives up, as it would in a skill.
    """
    touched = False
    with suppress(SkillFailure):
        for _ in motion:
            simulation.tick(("robot_0",))
            touched |= touch(simulation, "red_cube", "green_pad")
    simulation.rest(0.2)
    with suppress(SkillFailure):
        for _ in Moves(simulation.arms["robot_0"]).give_up():
            simulation.tick(("robot_0",))
    simulation.rest(1.5)
    return touched


def touch(simulation: Simulation, first: str, second: str) -> bool:
    scene = simulation.scene
    found = {
        frozenset(
            scene.entity_of_body(int(scene.model.geom_bodyid[geom])) or ""
            for geom in contact.geom
        )
        for contact in scene.data.contact[: scene.data.ncon]
    }
    return frozenset((first, second)) in found


def assert_not_climbed(simulation: Simulation) -> None:
    scene = simulation.scene
    assert not On("red_cube", "green_pad").holds(scene)
    # Nor does it lie on it otherwise, half over the edge or on another face.
    z = scene.pose("red_cube").position[2]
    beside = scene.pose2("red_cube").distance(scene.pose2("green_pad"))
    lowest = PAD_THICKNESS_M + CUBE_EDGE_M / 2 - 0.004
    assert z < lowest or beside > PAD_RADIUS_M + CUBE.disc_m


@pytest.mark.parametrize("speed_m_s", slow_but([0.05, 0.2, 0.5], 0.2))
@pytest.mark.parametrize("bearing", slow_but([-0.6, 0.0, 0.35], 0.35))
def test_a_cube_pushed_with_the_stick_does_not_climb_a_pad(
    speed_m_s: float, bearing: float
) -> None:
    target = BASE @ Pose2(AWAY_M, 0.0)
    heading = Pose2(target.x, target.y, bearing)
    start = heading @ Pose2(-BEFORE_M, 0.012, 0.3)
    # The head's middle meets the cube's.
    u, v = HANDLE_LENGTH_M + CUBE_EDGE_M / 2, 0.5 * (HOOK_LENGTH_M - STICK_SECTION_M)
    lying = Pose2(start.x, start.y, bearing) @ Pose2(-u - 0.03, -v)
    simulation = Simulation(
        facing(
            ARM,
            cube("red", *start.xy, start.yaw),
            pad("green", *target.xy),
            stick(lying),
        )
    )
    grip = grasp_on_stick(lying)
    height = DRAG_HEIGHT_M

    def push() -> Motion:
        moves = Moves(simulation.arms["robot_0"])
        low = stand_at(grip, STICK_GRASP_HEIGHT_M)
        yield from moves.grasp(stand_at(grip, 0.3), low)
        yield from moves.to(stand_at(grip, height), contact=True)
        end = stand_at(grip @ Pose2(BEFORE_M + 0.06, 0.0), height)
        yield from moves.along(stand_at(grip, height), end, speed_m_s)

    assert carry_out(simulation, push())
    assert_not_climbed(simulation)


@pytest.mark.parametrize("bearing", slow_but([-0.6, 0.0, 0.35], 0.35))
@pytest.mark.parametrize("height_m", slow_but([0.018, 0.03], 0.018))
def test_a_cube_pushed_slowly_with_the_hand_does_not_climb_a_pad(
    bearing: float, height_m: float
) -> None:
    """A faster hand may knock it up, but a hand so near could put it there as well."""
    target = BASE @ Pose2(0.8, 0.0)
    heading = Pose2(target.x, target.y, bearing)
    start = heading @ Pose2(-BEFORE_M, 0.0, 0.3)
    simulation = Simulation(
        facing(ARM, cube("red", *start.xy, 0.3), pad("green", *target.xy))
    )
    arm = simulation.arms["robot_0"]

    def at(along_m: float, z: float) -> Stand:
        return stand_at(heading @ Pose2(along_m, 0.0, math.pi / 2), z)

    def push() -> Motion:
        moves = Moves(arm)
        arm.opening_m = 0.0
        behind = -BEFORE_M - 0.07
        yield from moves.to(at(behind, 0.3))
        yield from moves.lower(at(behind, height_m))
        # Until the fingers are at the edge, where the cube was in their way.
        end = at(-PAD_RADIUS_M - 0.015, height_m)
        yield from moves.along(at(behind, height_m), end, 0.05)
        # Back first: fingers that rise beside a cube lift it.
        yield from moves.along(end, at(behind, height_m), 0.1)

    assert carry_out(simulation, push())
    assert_not_climbed(simulation)


def gap_scene(arm: str) -> tuple[SceneSpec, Pose2]:
    """A cube beyond a gap of the benchmark's width, where nobody could touch it."""
    could = could_of(arm)
    user = RobotPlacement(arm, "red", Pose2(-could.place_m - 0.05, 0.0))
    far = user.base.x + could.place_m + 0.03
    lying = Pose2(far + 0.05, 0.05, 0.2)
    partner = RobotPlacement(
        arm, "white", Pose2(lying.x + could.touch_m + 0.07, 0.0, math.pi)
    )
    tool = stick(user.base @ Pose2(0.4, -0.3, -0.3))
    objects = (cube("red", *lying.xy, lying.yaw), tool)
    gap = (round(far - 0.2, 4), round(far, 4))
    return SceneSpec((user, partner), objects, gap), lying


@pytest.mark.parametrize("arm", slow_but(["ur5", "ur10"], "ur10"))
def test_a_cube_hooked_across_the_gap_falls_and_rests_on_the_floor(arm: str) -> None:
    spec, lying = gap_scene(arm)
    user = spec.robots[0]
    # The planner knows no such drag, so plan it as if the table were whole.
    assert find_drag(Primitive.HOOK, user, user, lying, [], gap_m=spec.gap_m) is None
    drag = find_drag(Primitive.HOOK, user, user, lying, [])
    assert drag is not None
    simulation = Simulation(spec)
    scene = simulation.scene
    pick = grasp_on_stick(scene.pose2(STICK))
    prepare = GroundedSubTask("robot_0", Primitive.PREHOOK, pick, drag.prepared)
    assert simulation.execute(prepare).ok
    assert not scene.fallen
    pick = grasp_on_stick(scene.pose2(STICK))
    hook = GroundedSubTask("robot_0", Primitive.HOOK, pick, drag.end)
    assert not simulation.execute(hook).ok
    assert scene.fallen == ("red_cube",)
    simulation.rest(1.0)
    assert scene.pose("red_cube").position[2] == pytest.approx(
        FLOOR_Z_M + CUBE_EDGE_M / 2, abs=2e-3
    )
    assert scene.speed("red_cube") < 1e-3


@pytest.mark.parametrize("arm", slow_but(["ur5", "ur10"], "ur5"))
def test_a_cube_is_poked_away_over_a_gap(arm: str) -> None:
    spec, lying = gap_scene(arm)
    user, partner = spec.robots
    drag = find_drag(Primitive.POKE, user, partner, lying, [], gap_m=spec.gap_m)
    assert drag is not None
    simulation = Simulation(spec)
    scene = simulation.scene
    for primitive, place in (
        (Primitive.PREPOKE, drag.prepared),
        (Primitive.POKE, drag.end),
    ):
        pick = grasp_on_stick(scene.pose2(STICK))
        told = GroundedSubTask("robot_0", primitive, pick, place)
        assert simulation.execute(told).ok
    assert scene.pose2("red_cube").distance(drag.cube) < 0.02
    assert not scene.fallen
