"""The planner's state: poses of objects and their supports."""

import math

import pytest
from small_tables import cube, facing, pad, stick

from lemma.core.poses import Pose, Pose2
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.entity import SHARED, STICK
from lemma.scene.scene import Scene
from lemma.tasks.drags import PREPARE_GAP_M
from lemma.tasks.subtask import Primitive

SPEC = facing(
    "ur5",
    cube("red", 0.0, 0.1),
    cube("blue", 0.0, -0.1),
    cube("green", 0.2, -0.1),
    pad("white", 0.0, 0.3),
    pad("red", 0.2, 0.3),
    stick(Pose2(-0.3, -0.4, 0.0)),
)


@pytest.fixture
def scene() -> Scene:
    return Scene(SPEC)


def put(scene: Scene, name: str, x: float, y: float, z: float) -> SymbolicState:
    scene.set_pose(name, Pose((x, y, z)))
    return SymbolicState.observe(scene)


def test_a_fresh_table(scene: Scene) -> None:
    now = SymbolicState.observe(scene)
    cubes = ("red_cube", "blue_cube", "green_cube")
    assert now.supports == dict.fromkeys(cubes, TABLE)
    assert now.labels == dict.fromkeys((*cubes, STICK), "start")
    assert set(now.poses) == set(SPEC.object_names)
    for name in SPEC.object_names:
        assert now.poses[name].distance(SPEC.placement(name).pose) < 1e-9
    assert now.on_top_of("red_cube") is None


def test_a_cube_on_a_pad(scene: Scene) -> None:
    now = put(scene, "red_cube", 0.02, 0.32, 0.06)
    assert now.supports["red_cube"] == "white_pad"
    assert now.labels["red_cube"] == "on white_pad"
    assert now.on_top_of("white_pad") == "red_cube"
    assert put(scene, "red_cube", 0.0, 0.355, 0.06).supports["red_cube"] == TABLE


def test_towers(scene: Scene) -> None:
    now = put(scene, "red_cube", 0.01, -0.09, 0.075)
    assert now.supports["red_cube"] == "blue_cube"
    assert now.on_top_of("blue_cube") == "red_cube"
    now = put(scene, "green_cube", 0.0, -0.1, 0.125)
    assert now.supports["green_cube"] == "red_cube"
    assert now.supports["red_cube"] == "blue_cube"
    assert now.supports["blue_cube"] == TABLE
    assert now.labels["green_cube"] == "on red_cube"


def test_a_tower_on_a_pad(scene: Scene) -> None:
    put(scene, "red_cube", 0.2, 0.3, 0.06)
    now = put(scene, "blue_cube", 0.2, 0.3, 0.11)
    assert now.supports["red_cube"] == "red_pad"
    assert now.supports["blue_cube"] == "red_cube"


def test_a_moved_thing_makes_a_new_situation(scene: Scene) -> None:
    now = SymbolicState.observe(scene)
    before = now.key
    there = Pose2(0.1, 0.2, 0.3)
    then = now.moved("red_cube", there, "blue_cube", "on blue_cube")
    assert now.key == before
    assert now.supports["red_cube"] == TABLE
    assert then.supports["red_cube"] == "blue_cube"
    assert then.poses["red_cube"] == there
    assert then.on_top_of("blue_cube") == "red_cube"
    assert then.key != now.key
    # The stick lies on nothing in particular.
    carried = now.moved(STICK, there, TABLE, SHARED)
    assert STICK not in carried.supports
    assert carried.labels[STICK] == SHARED


def test_two_ways_to_one_place_are_one_state(scene: Scene) -> None:
    now = SymbolicState.observe(scene)
    one = now.moved("red_cube", Pose2(0.0, 0.0), TABLE, SHARED)
    other = now.moved("red_cube", Pose2(0.01, 0.0), TABLE, SHARED)
    assert one.key == other.key


@pytest.mark.parametrize(
    ("primitive", "ahead", "beside"),
    [(Primitive.HOOK, 0.695 - PREPARE_GAP_M, 0.075), (Primitive.POKE, 0.795, 0.06)],
)
def test_a_stick_that_lies_ready(
    scene: Scene, primitive: Primitive, ahead: float, beside: float
) -> None:
    lying = Pose2(-0.2, -0.3, 0.4)
    half = lying.yaw / 2
    upright = (math.cos(half), 0.0, 0.0, math.sin(half))
    scene.set_pose(STICK, Pose((lying.x, lying.y, 0.015), upright))
    (other,) = {Primitive.HOOK, Primitive.POKE} - {primitive}
    at = lying @ Pose2(ahead, beside)
    now = put(scene, "red_cube", at.x, at.y, 0.025)
    assert now.is_prepared(primitive, "red_cube")
    assert not now.is_prepared(other, "red_cube")
    assert not now.is_prepared(primitive, "blue_cube")


def test_without_a_stick_nothing_lies_ready() -> None:
    now = SymbolicState.observe(Scene(facing("ur5", cube("red", 0.0, 0.0))))
    assert not now.is_prepared(Primitive.HOOK, "red_cube")
