"""States that look like success and are none, and those that are: by contact alone."""

import math

import pytest
from small_tables import cube, facing, pad, stretch

from lemma.core.poses import Pose
from lemma.env.simulation import Simulation
from lemma.robots.gripper import (
    FINGER_OPENING_M,
    FINGER_THICKNESS_M,
    FINGERTIP_BEYOND_TCP_M,
)
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.tasks.goal import TILT_RAD, Goal, On

HALF = 0.025
X, Y = 0.0, 0.3
A, B, C = "red_cube", "blue_cube", "green_cube"
GOAL = Goal.from_pairs(((A, B),))
TABLE = facing(
    "ur5",
    cube("red", 0.0, 0.0),
    cube("blue", 0.0, 0.15),
    cube("green", 0.0, -0.15),
    pad("white", -0.15, -0.15),
)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return Simulation(TABLE)


@pytest.fixture
def scene(simulation: Simulation) -> Scene:
    """A table on which nothing lies where the tests build."""
    for k, name in enumerate((A, B, C)):
        put(simulation.scene, name, (0.1 * k - 0.1, -0.3, HALF))
    return simulation.scene


def put(
    scene: Scene,
    name: str,
    position: tuple[float, float, float],
    turn_rad: float = 0.0,
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> None:
    part = math.sin(turn_rad / 2)
    x, y, z = (part * one for one in axis)
    scene.set_pose(name, Pose(position, (math.cos(turn_rad / 2), x, y, z)))


def stack(scene: Scene) -> None:
    put(scene, B, (X, Y, HALF))
    put(scene, A, (X, Y, 3 * HALF - 1e-5))


@pytest.mark.parametrize("quarter", [1, 2, 3])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_cube_may_stand_on_any_of_its_faces(
    simulation: Simulation,
    scene: Scene,
    axis: tuple[float, float, float],
    quarter: int,
) -> None:
    stack(scene)
    put(scene, A, (X, Y, 3 * HALF), quarter * math.pi / 2, axis)
    put(scene, B, (X, Y, HALF), quarter * math.pi / 2, axis)
    simulation.rest(1.0)
    assert GOAL.progress(scene) == 1.0


def test_it_is_asked_of_a_state_not_of_what_was_computed_last(
    simulation: Simulation, scene: Scene
) -> None:
    """Contacts of the last step are of another moment, and so is what a goal says."""
    stack(scene)
    simulation.rest(1.0)
    kept = scene.snapshot()
    put(scene, A, (X, Y, 0.5))
    assert GOAL.progress(scene) == 0.0
    scene.restore(kept)
    assert GOAL.progress(scene) == 1.0
    before = scene.state_hash()
    GOAL.progress(scene)
    assert scene.state_hash() == before


# --- Taken for success by version 1 ------------------------------------------------


def test_a_bridge_on_two_cubes_is_on_neither(
    simulation: Simulation, scene: Scene
) -> None:
    put(scene, B, (X - 0.0245, Y, HALF))
    put(scene, C, (X + 0.0275, Y, HALF))
    put(scene, A, (X, Y, 3 * HALF))
    simulation.rest(1.0)
    assert scene.pose(A).position[2] == pytest.approx(3 * HALF, abs=1e-4)
    assert GOAL.progress(scene) == 0.0
    assert not On(A, C).holds(scene)


@pytest.mark.parametrize("name", [A, B])
def test_tilted_is_not_standing(scene: Scene, name: str) -> None:
    stack(scene)
    height = scene.pose(name).position[2]
    put(scene, name, (X, Y, height), 0.9 * TILT_RAD)
    assert GOAL.progress(scene) == 1.0
    put(scene, name, (X, Y, height), 1.1 * TILT_RAD)
    assert GOAL.progress(scene) == 0.0
    put(scene, A, (X, Y, 3 * HALF + 0.004), math.radians(12.0))
    assert GOAL.progress(scene) == 0.0


def test_a_falling_pair_is_no_stack(scene: Scene) -> None:
    put(scene, B, (5.0, 5.0, -3.0))
    put(scene, A, (5.0, 5.0, -3.0 + 2 * HALF - 1e-5))
    assert scene.fallen == (A, B)
    assert GOAL.progress(scene) == 0.0


def test_what_leans_on_a_third_thing_is_not_carried_alone(
    simulation: Simulation, scene: Scene
) -> None:
    """A cube beside the upper one, on a tower of its own, touches it from the side."""
    stack(scene)
    simulation.rest(0.5)
    assert GOAL.progress(scene) == 1.0
    put(scene, C, (X + 2 * HALF - 1e-5, Y, 3 * HALF))
    assert GOAL.progress(scene) == 0.0


def test_on_a_pad_and_on_the_table_is_not_on_the_pad(
    simulation: Simulation, scene: Scene
) -> None:
    spot = scene.pose2("white_pad")
    top_m = entity_named("white_pad").kind.top_m
    goal = Goal.from_pairs(((A, "white_pad"),))
    put(scene, A, (spot.x, spot.y, top_m + HALF))
    simulation.rest(1.0)
    assert goal.progress(scene) == 1.0
    edge = entity_named("white_pad").kind.disc_m
    put(scene, A, (spot.x + edge + 0.01, spot.y, HALF + 0.5 * top_m), -0.05, (0, 1, 0))
    simulation.rest(1.0)
    assert goal.progress(scene) == 0.0


@pytest.mark.parametrize("name", [A, B])
def test_what_a_robot_touches_is_not_there_yet(name: str) -> None:
    """A hand that leans on a stack may be what keeps it up."""
    tip_m = 0.098 if name == A else 0.048
    simulation = Simulation(TABLE)
    scene = simulation.scene
    stretch(simulation, (X, Y, tip_m + FINGERTIP_BEYOND_TCP_M))
    finger = Y + FINGER_OPENING_M / 2 + FINGER_THICKNESS_M
    for apart_m, held in ((0.01, 1.0), (-0.002, 0.0)):
        side = finger + apart_m + HALF
        put(scene, B, (X, side, HALF))
        put(scene, A, (X, side + (0.0 if name == A else 0.02), 3 * HALF - 1e-5))
        assert GOAL.progress(scene) == held
