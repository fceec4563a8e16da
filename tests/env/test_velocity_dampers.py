"""Velocity dampers: the same as a plain reference, also for teams of three."""

import itertools

import mujoco
import numpy as np
import pytest
from tiers import slow_but

from lemma.core.errors import CapacityError
from lemma.core.poses import FloatArray, Pose, Pose2
from lemma.env.control.controllers import Controller, StepSize
from lemma.env.control.guarded_arm import (
    CAPSULES,
    CLEARANCE_M,
    CORNERS,
    DECELERATION_M_S2,
    RANGE_M,
    SELF_MARGIN_M,
)
from lemma.env.control.modes import CONTROLS
from lemma.env.control.safety_filter import keep_clear
from lemma.env.control.velocity_dampers import (
    _IN_HAND_M,
    _SLACK_M_S,
    _SWEEPS,
    _TOUCH_M_S,
    _add_row,
    most_rows,
)
from lemma.env.simulation import Simulation
from lemma.robots.collision_model import SELF_PAIRS, closest_points
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.kinematics import frames
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec

TEAMS = {
    "two": (("ur5", -0.5, 0.0, 0.0), ("ur10", 0.6, 0.0, np.pi)),
    "three": (
        ("ur5", -0.55, -0.2, 0.0),
        ("ur5", 0.55, -0.2, np.pi),
        ("ur10", 0.0, 0.6, -np.pi / 2),
    ),
}
READY = np.array([0.0, -1.4, 1.4, -1.5, -1.5, 0.0])
OBJECTS = (("cube", "red"), ("cube", "green"), ("cube", "blue"), ("stick", "yellow"))


def simulation_of(team: str) -> Simulation:
    robots = tuple(
        RobotPlacement(arm, "white", Pose2(x, y, yaw)) for arm, x, y, yaw in TEAMS[team]
    )
    objects = tuple(
        ObjectPlacement(kind, color, Pose2(-0.3 + 0.15 * i, 0.05 * i, 0.4 * i))
        for i, (kind, color) in enumerate(OBJECTS)
    )
    return Simulation(SceneSpec(robots, objects))


def controller_of(simulation: Simulation, control: str) -> Controller:
    arms = tuple(simulation.arms.values())
    return CONTROLS[control].controller(arms, StepSize())


class Plain:
    """The same dampers without anything left out, in NumPy and plain Python."""

    def __init__(self, controller: Controller, number: int) -> None:
        record = controller.guard.records[number]
        self.parts, self.limits = record["parts"], record["speeds"]
        self.dh, self.base = record["dh"], record["world_from_base"]
        objects = controller.guard.objects[number]
        self.beside = objects[0, : record["beside"]]
        self.inside = objects[1, : record["inside"]]
        self.others = controller.guard.obstacles[number]
        self.rows: list[list[float]] = []

    def add(
        self, links: tuple[int, int], near: FloatArray, far: FloatArray, gap: float
    ) -> bool:
        away = far - near
        x, y, z = away.tolist()
        length = np.sqrt(x * x + y * y + z * z)
        if gap > RANGE_M or length < 1e-9:
            return False
        x, y, z = x / length, y / length, z / length
        row = [0.0] * 6
        for j in range(*links):
            f = self.placed[j]
            a, b, c = (near - f[:3, 3]).tolist()
            row[j] = float(
                x * (f[1, 2] * c - f[2, 2] * b)
                + y * (f[2, 2] * a - f[0, 2] * c)
                + z * (f[0, 2] * b - f[1, 2] * a)
            )
        room = max(0.0, gap - CLEARANCE_M)
        self.rows.append([*row, float(np.sqrt(2.0 * DECELERATION_M_S2 * room))])
        return True

    def soft(self, near: FloatArray, far: FloatArray, gap: float) -> None:
        if self.add((0, 6), near, far, gap):
            self.rows[-1][6] = max(self.rows[-1][6], _TOUCH_M_S)

    def pair(
        self, links: tuple[int, int], a: FloatArray, b: FloatArray, margin: float
    ) -> None:
        gap, near, far = closest_points(a, b)
        self.add(links, np.array(near), np.array(far), gap - margin)

    def collect(self, q: FloatArray) -> None:
        self.placed = np.empty((7, 4, 4))
        frames(self.dh, self.base, q, self.placed)
        world = np.zeros((len(self.parts), 7))
        for out, part in zip(world, self.parts, strict=True):
            f = self.placed[int(part[7])]
            for end, i in itertools.product(range(2), range(3)):
                value = f[i, 3]
                for j in range(3):
                    value += f[i, j] * part[3 * end + j]
                out[3 * end + i] = value
            out[6] = part[6]
        down = np.array([0.0, 0.0, 1.0])
        link = [int(part[7]) for part in self.parts]
        for i, end in itertools.product(range(2, 8), (0, 3)):
            near = world[i, end : end + 3]
            self.add((0, link[i]), near, near - down, near[2] - world[i, 6])
        for corner in world[CAPSULES:]:
            self.add((0, 6), corner[:3], corner[:3] - down, corner[2])
            for thing in self.beside:
                gap, a, b = closest_points(corner, thing)
                self.soft(np.array(a), np.array(b), gap)
        for thing, end in itertools.product(self.inside, (0, 3)):
            point = thing[end : end + 3]
            half = thing[7] - max(thing[2], thing[5])
            self.soft(point, point - down, point[2] - half)
        for outer, inner in SELF_PAIRS:
            links = (link[inner], link[outer])
            self.pair(links, world[outer], world[inner], SELF_MARGIN_M)
        for corner, inner in itertools.product(range(CAPSULES, len(world)), range(3)):
            links = (link[inner], 6)
            self.pair(links, world[corner], world[inner], SELF_MARGIN_M)
        for i, other in itertools.product(range(1, CAPSULES), self.others):
            gap, a, b = closest_points(world[i], other)
            self.add((0, link[i]), np.array(a), np.array(b), 0.5 * gap)
        tool = self.placed[6, :3, 3] + TCP_OFFSET_M * self.placed[6, :3, 2]
        for thing in self.beside:
            point = np.array([*tool, *tool, 0.0])
            if closest_points(point, thing)[0] + thing[6] >= _IN_HAND_M:
                for i in range(2, 7):
                    self.pair((0, link[i]), world[i], thing, 0.0)

    def restrain(self, q: FloatArray, rates: FloatArray) -> bool:
        self.collect(q)
        changed = False
        for _ in range(_SWEEPS):
            clean = True
            for row in self.rows:
                approach = norm = 0.0
                for a, rate in zip(row[:6], rates.tolist(), strict=True):
                    approach += a * rate
                    norm += a * a
                if approach > row[6] and norm > 1e-12:
                    changed, clean = True, False
                    step = (approach - row[6]) / norm
                    for j in range(6):
                        rates[j] -= step * row[j]
            if clean:
                break
        if not changed:
            return False
        scale = 1.0
        for rate, limit in zip(rates.tolist(), self.limits.tolist(), strict=True):
            if abs(rate) * scale > limit:
                scale = limit / abs(rate)
        for row in self.rows:
            approach = 0.0
            for a, rate in zip(row[:6], rates.tolist(), strict=True):
                approach += a * rate
            if approach * scale > row[6] + _SLACK_M_S:
                scale = (row[6] + _SLACK_M_S) / approach
        rates *= scale
        return True


@pytest.mark.slow
@pytest.mark.parametrize("team", slow_but(TEAMS, "two"))
def test_nothing_that_matters_is_left_out(team: str) -> None:
    simulation, rng = simulation_of(team), np.random.default_rng(len(team))
    scene, changes = simulation.scene, 0
    controller = controller_of(simulation, "joint_position")
    for _ in range(120):
        for robot in scene.robots:
            scene.data.qpos[robot.qpos] = READY + rng.uniform(-1.6, 1.6, 6)
        for name in scene.movable_names:
            x, y, z = rng.uniform((-0.5, -0.4, 0.0), (0.5, 0.6, 0.4))
            scene.set_pose(name, Pose((x, y, z)))
        controller.guard.look()
        for number, record in enumerate(controller.guard.records):
            q = scene.data.qpos[scene.robots[number].qpos].copy()
            speed = rng.choice([0.1, 0.5, 1.0]) * record["speeds"]
            given = rng.uniform(-speed, speed)
            ours, plain = given.copy(), given.copy()
            obstacles = controller.guard.obstacles[number]
            objects = controller.guard.objects[number]
            changed = keep_clear(record, obstacles, objects, q, ours)
            reference = Plain(controller, number)
            assert reference.restrain(q, plain) == changed
            np.testing.assert_array_equal(ours, plain)
            beside, inside = len(reference.beside), len(reference.inside)
            assert len(reference.rows) <= most_rows(len(obstacles), beside + inside)
            changes += changed
    assert changes > 60


def test_there_is_room_for_all_constraints_of_three_robots() -> None:
    controller = controller_of(simulation_of("three"), "joint_position")
    controller.guard.look()
    rows = most_rows(controller.guard.obstacles.shape[1], 5)
    assert rows == 12 + CORNERS + 42 + 9 * 20 + (CORNERS + 5) * 5 > 256


def test_more_constraints_than_there_is_room_for_are_an_error() -> None:
    controller = controller_of(simulation_of("two"), "joint_position")
    controller.guard.look()
    found, rows = (0.1, (0.0, 0.0, 0.1), (0.0, 0.0, -0.9)), np.zeros((1, 7))
    record = controller.guard.records[0]
    assert _add_row(record, (0, 9), found, 0.0, 1e6, rows, 0) == 1
    with pytest.raises(CapacityError, match="dampers"):
        _add_row(record, (0, 9), found, 0.0, 1e6, rows, 1)


@pytest.mark.parametrize("control", ["joint_position", "joint_velocity", "ee_pose"])
def test_three_wild_robots_keep_their_limits(control: str) -> None:
    simulation = simulation_of("three")
    scene, rng = simulation.scene, np.random.default_rng(5)
    if CONTROLS[control].actuation != scene.actuation:
        simulation = Simulation(scene.spec, CONTROLS[control].actuation)
        scene = simulation.scene
    controller = controller_of(simulation, control)
    layout = CONTROLS[control].layout(scene.spec.robot_names)
    worst = 0.0
    for _ in range(60):
        controller.command(rng.uniform(layout.low, layout.high, layout.shape))
        for _ in range(5):
            simulation.run(controller.run, 1)
            for robot in scene.robots:
                speeds = np.abs(scene.data.qvel[robot.dof]) / robot.arm.velocity_limits
                worst = max(worst, float(speeds.max()))
    assert 0.5 < worst <= 1.0
    assert not scene.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
