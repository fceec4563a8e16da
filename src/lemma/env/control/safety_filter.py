"""Keeps an arm that is commanded joint by joint from running into things.

A hand that is rammed into the table throws the wrist's joints far beyond their limits.
:mod:`lemma.env.control.velocity_dampers` says how that is prevented.

Covered are the table, the arm itself and the other arms. Objects are there to be
touched by hands, but not at speed, and not by the rest of an arm.
"""

import math

import numpy as np

from lemma.core.poses import FloatArray
from lemma.env.control.velocity_dampers import restrain
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.collision_model import closest_points, envelope_of
from lemma.robots.ur.kinematics import frames
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import Point
from lemma.scene.scene import Scene

# What is held is nearer to the tool centre point than the one, and the fingers are as
# far apart as it is wide, give or take the other.
_HELD_M = 0.03
_GRIPPED_M = 0.006


class SafetyFilter:
    """Watches over one arm."""

    def __init__(self, arm: ArmMotion, others: tuple[ArmMotion, ...]) -> None:
        """Begin to watch.

        Args:
            arm: The arm.
            others: The other arms of the scene.
        """
        self._arm = arm
        self._others = others
        envelope = envelope_of(arm.robot.arm.name)
        self._capsules = np.column_stack([envelope.capsules, envelope.capsule_links])
        self._obstacles = np.zeros((0, 7))
        self._objects = np.zeros((0, 8))
        self._held = np.zeros((0, 8))
        self._placed = np.empty((7, 4, 4))

    def look(self) -> None:
        """See where the other arms and the objects are now."""
        self._obstacles = np.concatenate(
            [np.zeros((0, 7)), *(other.capsules() for other in self._others)]
        )
        scene, tcp = self._arm.scene, self._arm.tcp_pose()[:3, 3]
        opening = scene.opening_m(self._arm.robot)
        point = np.array([*tcp, *tcp, 0.0])
        objects: list[FloatArray] = []
        held: list[FloatArray] = []
        for name in scene.spec.object_names:
            shell, grasp = _shell(scene, name), kind_of(name).grasp
            away = min(
                (
                    closest_points(point, capsule, np.empty(3), np.empty(3))
                    + capsule[6]
                    for capsule in shell
                ),
                default=math.inf,
            )
            gripped = grasp is not None and abs(opening - grasp.width_m) < _GRIPPED_M
            (held if gripped and away < _HELD_M else objects).extend(shell)
        self._objects = np.array(objects).reshape(-1, 8)
        self._held = np.array(held).reshape(-1, 8)

    def restrain(self, q: FloatArray, rates: FloatArray, limits: FloatArray) -> bool:
        """Change joint speeds as little as it takes to keep clear.

        Args:
            q: Joint angles, (6,) [rad].
            rates: Joint speeds, (6,) [rad/s]; changed in place.
            limits: Largest joint speeds, (6,) [rad/s].

        Returns:
            Whether anything had to be changed.
        """
        robot = self._arm.robot
        frames(robot.arm.dh, robot.world_from_base, q, self._placed)
        return bool(
            restrain(
                self._placed,
                self._capsules,
                self._obstacles,
                self._objects,
                self._held,
                rates,
                limits,
            )
        )


def _shell(scene: Scene, name: str) -> list[FloatArray]:
    """Return an object as capsules, each with the height of its top, (8,) [m]."""
    shell, matrix = kind_of(name).shell, scene.pose(name).matrix()
    found = [
        np.array([*_placed(matrix, c.start), *_placed(matrix, c.end), c.radius_m, 0.0])
        for c in shell.capsules
    ]
    for row in found:
        row[7] = max(found[0][2], found[0][5]) + shell.rim_m
    return found


def _placed(matrix: FloatArray, point: Point) -> list[float]:
    """Return a point of a body's frame in the world [m]."""
    x, y, z = point
    return [
        float(matrix[i, 3] + x * matrix[i, 0] + y * matrix[i, 1] + z * matrix[i, 2])
        for i in range(3)
    ]
