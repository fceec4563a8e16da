"""When a cube is on something: carried by it alone, level, at rest, near its middle."""

import math

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.errors import UnknownNameError
from lemma.core.poses import Pose, Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.pad import PAD_RADIUS_M, PAD_THICKNESS_M
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import REST_M_S, REST_RAD_S, Goal, On

HALF = CUBE_EDGE_M / 2
PAD = Pose2(0.1, -0.2, 0.4)
SPEC = SceneSpec(
    (
        RobotPlacement("ur5", "red", Pose2(-0.9, 0.0, 0.0)),
        RobotPlacement("ur5", "white", Pose2(0.9, 0.0, math.pi)),
    ),
    (
        ObjectPlacement("cube", "red", Pose2(0.1, 0.2)),
        ObjectPlacement("cube", "blue", Pose2(-0.1, 0.2)),
        ObjectPlacement("cube", "green", Pose2(-0.1, 0.4)),
        ObjectPlacement("pad", "white", PAD),
        ObjectPlacement("pad", "pink", Pose2(-0.3, -0.2)),
    ),
)
ON_PAD = On("red_cube", "white_pad")
ON_CUBE = On("red_cube", "blue_cube")
angles = st.floats(-math.pi, math.pi)
PRESS = 1e-5
"""Depth of an object in its support [m]: contacts are soft."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(SPEC)


def put(
    scene: Scene, name: str, x: float, y: float, z: float, yaw: float = 0.0
) -> None:
    upright = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    scene.set_pose(name, Pose((x, y, z - PRESS), upright))


def beside(pose: Pose2, away: float, bearing: float) -> tuple[float, float]:
    return pose.x + away * math.cos(bearing), pose.y + away * math.sin(bearing)


@given(st.floats(0.0, 0.0499), angles, angles)
def test_on_a_pad(scene: Scene, away: float, bearing: float, yaw: float) -> None:
    x, y = beside(PAD, away, bearing)
    put(scene, "red_cube", x, y, PAD_THICKNESS_M + HALF, yaw)
    assert ON_PAD.holds(scene)


@given(st.floats(0.0501, 1.0), angles)
def test_beside_a_pad_or_on_its_edge(scene: Scene, away: float, bearing: float) -> None:
    put(scene, "red_cube", *beside(PAD, away, bearing), PAD_THICKNESS_M + HALF)
    assert not ON_PAD.holds(scene)
    assert pytest.approx(0.05) == PAD_RADIUS_M - 0.01


@given(st.floats(0.0001, 0.5))
def test_above_a_pad_and_not_touching_it(scene: Scene, lift: float) -> None:
    put(scene, "red_cube", PAD.x, PAD.y, PAD_THICKNESS_M + HALF + lift)
    assert not ON_PAD.holds(scene)


@given(st.floats(0.0, 0.0249), angles, angles)
def test_on_a_cube(scene: Scene, away: float, bearing: float, yaw: float) -> None:
    put(scene, "blue_cube", -0.1, 0.2, HALF)
    x, y = beside(Pose2(-0.1, 0.2), away, bearing)
    put(scene, "red_cube", x, y, 3 * HALF - PRESS, yaw)
    assert ON_CUBE.holds(scene)
    assert not On("blue_cube", "red_cube").holds(scene)
    assert not On("green_cube", "blue_cube").holds(scene)


@given(st.floats(0.0251, 0.3), angles)
def test_beside_a_cube(scene: Scene, away: float, bearing: float) -> None:
    below = scene.pose2("blue_cube")
    x, y = beside(below, away, bearing)
    for z in (3 * HALF, HALF):
        put(scene, "red_cube", x, y, z)
        assert not ON_CUBE.holds(scene)


def test_a_tower_on_a_pad_puts_only_its_foot_on_the_pad(scene: Scene) -> None:
    foot = PAD_THICKNESS_M + HALF
    put(scene, "blue_cube", PAD.x, PAD.y, foot)
    put(scene, "red_cube", PAD.x, PAD.y, foot + CUBE_EDGE_M - PRESS)
    assert On("blue_cube", "white_pad").holds(scene)
    assert ON_CUBE.holds(scene)
    assert not ON_PAD.holds(scene)


@pytest.mark.parametrize("name", ["red_cube", "blue_cube"])
@pytest.mark.parametrize("axis", range(6))
def test_what_moves_or_turns_is_not_there_yet(
    scene: Scene, name: str, axis: int
) -> None:
    limit = REST_M_S if axis < 3 else REST_RAD_S
    put(scene, "blue_cube", -0.1, 0.2, HALF)
    put(scene, "red_cube", -0.1, 0.2, 3 * HALF - PRESS)
    dof = int(scene.model.joint(name).dofadr[0]) + axis
    scene.data.qvel[dof] = 0.99 * limit
    assert ON_CUBE.holds(scene)
    scene.data.qvel[dof] = -1.01 * limit
    assert not ON_CUBE.holds(scene)


def test_a_cube_let_go_over_a_pad_is_on_it_once_it_rests() -> None:
    scene = Scene(SPEC)
    put(scene, "red_cube", PAD.x + 0.03, PAD.y, PAD_THICKNESS_M + HALF + 0.02)
    seen = []
    for _ in range(200):
        mujoco.mj_step(scene.model, scene.data)
        seen.append(ON_PAD.holds(scene))
    assert not seen[0]
    assert all(seen[-100:])


def test_progress_counts_what_holds(scene: Scene) -> None:
    goal = Goal.from_pairs((("red_cube", "white_pad"), ("blue_cube", "pink_pad")))
    height = PAD_THICKNESS_M + HALF
    put(scene, "red_cube", 0.5, 0.5, HALF)
    put(scene, "blue_cube", 0.6, 0.5, HALF)
    assert goal.progress(scene) == 0.0
    put(scene, "red_cube", PAD.x, PAD.y, height)
    assert goal.progress(scene) == 0.5
    put(scene, "blue_cube", -0.3, -0.2, height)
    assert goal.progress(scene) == 1.0
    put(scene, "red_cube", 0.5, 0.5, HALF)
    assert goal.progress(scene) == 0.5


def test_entities_are_named_once_each() -> None:
    goal = Goal.from_pairs((("red_cube", "blue_cube"), ("green_cube", "red_cube")))
    assert goal.entities == ("red_cube", "blue_cube", "green_cube")
    assert goal.pairs == (("red_cube", "blue_cube"), ("green_cube", "red_cube"))
    assert Goal.from_pairs(goal.pairs) == goal


def test_a_goal_about_what_is_not_there_is_answered(scene: Scene) -> None:
    with pytest.raises(UnknownNameError, match="Unknown object in this scene"):
        On("pink_cube", "white_pad").holds(scene)
