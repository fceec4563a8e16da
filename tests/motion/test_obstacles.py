"""Obstacles of an arm: other arms and objects around, not the object it works on."""

import numpy as np
import pytest
from small_tables import cube, facing, pad, stick

from lemma.core.poses import FloatArray, Pose2
from lemma.env.simulation import Simulation
from lemma.motion.obstacles import Obstacles
from lemma.scene.objects.entity import STICK

SPEC = facing(
    "ur5",
    cube("red", -0.1, 0.2),
    cube("blue", 0.1, -0.2),
    pad("green", 0.0, 0.4),
    stick(Pose2(-0.3, -0.4, 0.0)),
)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return Simulation(SPEC)


def obstacles(
    simulation: Simulation, target: Pose2 | None = None, held: str | None = None
) -> FloatArray:
    """The rows that stand for objects."""
    arms = simulation.arms
    rows = Obstacles(arms).around("robot_0", target, held)
    others = len(arms["robot_1"].capsules())
    found: FloatArray = rows[others:]
    return found


def test_the_other_arm_is_an_obstacle_and_the_arm_itself_is_not(
    simulation: Simulation,
) -> None:
    arms = simulation.arms
    rows = Obstacles(arms).around("robot_0", None, None)
    capsules = arms["robot_1"].capsules()
    assert np.array_equal(rows[: len(capsules), :7], capsules)
    assert (rows[: len(capsules), 7] == 0.15).all()
    # All of it is at the other side of the table.
    assert rows[: len(capsules), 0].min() > 0.0


def test_cubes_and_the_stick_are_obstacles_and_pads_are_not(
    simulation: Simulation,
) -> None:
    rows = obstacles(simulation)
    assert rows.shape == (3, 8)
    first = rows[0]
    assert first[:2] == pytest.approx([-0.1, 0.2], abs=1e-4)
    # Its inscribed ball.
    assert first[6] == pytest.approx(0.025)
    # The stick is its handle.
    handle = rows[2]
    assert handle[:2] == pytest.approx([-0.3, -0.4], abs=1e-4)
    assert handle[3:5] == pytest.approx([0.45, -0.4], abs=1e-4)
    assert handle[2] == handle[5] == pytest.approx(0.015, abs=1e-3)
    assert handle[6] == pytest.approx(0.015)


@pytest.mark.parametrize("held", ["red_cube", "blue_cube", STICK])
def test_what_is_held_is_no_obstacle(simulation: Simulation, held: str) -> None:
    rows = obstacles(simulation, held=held)
    assert len(rows) == 2
    x, y, _ = simulation.scene.pose(held).position
    assert np.hypot(rows[:, 0] - x, rows[:, 1] - y).min() > 0.05


@pytest.mark.parametrize(
    ("target", "left"),
    [
        (Pose2(-0.1, 0.2), 2),
        (Pose2(-0.1, 0.05), 2),
        (Pose2(-0.1, 0.03), 3),
        # Beside the middle of the handle, far from both its ends.
        (Pose2(-0.05, -0.5), 2),
        (Pose2(0.0, 0.4), 3),
    ],
)
def test_what_stands_where_the_arm_works_is_no_obstacle(
    simulation: Simulation, target: Pose2, left: int
) -> None:
    assert len(obstacles(simulation, target=target)) == left


def test_without_objects_there_are_the_arms() -> None:
    arms = Simulation(facing("ur5")).arms
    rows = Obstacles(arms).around("robot_1", None, None)
    assert np.array_equal(rows[:, :7], arms["robot_0"].capsules())


def test_a_lone_arm_has_no_obstacles(simulation: Simulation) -> None:
    arm = simulation.arms["robot_0"]
    lone = Obstacles({"robot_0": arm})
    rows = lone.around("robot_0", Pose2(-0.1, 0.2), "blue_cube")
    assert rows.shape == (1, 8)
    assert rows[0, 4] == pytest.approx(-0.4, abs=1e-3)
