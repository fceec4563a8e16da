"""Prevents collisions of arms that are commanded joint by joint.

A hand that hits the table at speed would drive the wrist joints far beyond their
limits. The method is in :mod:`lemma.env.control.velocity_dampers`.

The filter covers the table, the arm itself and the other arms. A hand may touch
objects, but gently; the rest of an arm may not touch them.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import borrowed, kernel
from lemma.core.poses import FloatArray
from lemma.env.control.guarded_arm import CAPSULES, ROW, arm_records, enclose
from lemma.env.control.velocity_dampers import restrain
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.collision_model import closest_points, place_capsules
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.ur.kinematics import frames
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene

Guard = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Objects of a scene and their capsules, and what :class:`SafetyFilter` makes of them:
obstacles and objects for each arm."""

ARM_RANGE_M = 0.15
"""Distance within which RMPflow avoids the other arms, as in skills."""

# An object is held if its distance to the tool centre point is below the first limit,
# and its width differs from the opening of the fingers by less than the second.
_HELD_M = 0.03
_GRIPPED_M = 0.006


class SafetyFilter:
    """Obstacles of the arms of a scene, for the kernels that drive them."""

    def __init__(self, arms: Sequence[ArmMotion]) -> None:
        """Prepare the records of arms and objects.

        Args:
            arms: All arms of a scene.
        """
        self.records: NDArray[np.void] = arm_records(arms)
        """One record for each arm; see :data:`~lemma.env.control.guarded_arm.ARM`."""
        count = len(arms)
        self.obstacles = np.zeros((count, CAPSULES * (count - 1), ROW))
        """For each arm the capsules of the others, see
        :data:`~lemma.env.control.guarded_arm.ROW`."""
        self.obstacles[:, :, 7] = ARM_RANGE_M
        scene = arms[0].scene
        owners, capsules = _shells(scene)
        self.objects = np.zeros((count, 2, len(capsules), ROW))
        """For each arm, capsules of objects: first of those outside its hand, then of
        those in it. The arm's record has the counts."""
        self.arrays: Guard = (owners, capsules, self.obstacles, self.objects)
        """Arguments of the kernels."""
        self._qpos: FloatArray = scene.data.qpos

    def look(self) -> None:
        """Read the present poses of arms and objects, once in each servo tick."""
        find_obstacles(self.arrays, self.records, self._qpos)


@kernel
def keep_clear(
    arm: np.record,
    obstacles: FloatArray,
    objects: FloatArray,
    q: FloatArray,
    rates: FloatArray,
) -> bool:
    """Change joint speeds as little as needed to avoid collisions.

    Args:
        arm: The arm; see :data:`~lemma.env.control.guarded_arm.ARM`.
        obstacles: Those of :class:`SafetyFilter` for this arm.
        objects: The same.
        q: Joint angles, (6,) [rad].
        rates: Joint speeds, (6,) [rad/s]; changed in place.

    Returns:
        Whether any speed changed.
    """
    moves = False
    for i in range(6):
        moves = moves or rates[i] != 0.0
    # An arm that stands approaches nothing.
    if not moves:
        return False
    frames(arm.dh, arm.world_from_base, q, arm.placed)
    beside, inside = objects[0, : arm.beside], objects[1, : arm.inside]
    return restrain(arm, obstacles, beside, inside, rates)


def _shells(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return the objects and their enclosing capsules.

    Returns:
        For each object the address in ``qpos`` or -1, its pose if it is fixed, its
        width in a grip (or NaN), and the height of its top above the higher end of its
        first capsule's axis, (n, 10); and capsules in objects' frames with the index of
        the object, (m, 8) [m].
    """
    owners: list[list[float]] = []
    capsules: list[list[float]] = []
    for number, name in enumerate(scene.spec.object_names):
        kind, pose, address = kind_of(name), scene.pose(name), -1.0
        if name in scene.movable_names:
            address = float(scene.model.joint(name).qposadr[0])
        width = math.nan if kind.grasp is None else kind.grasp.width_m
        fixed = (*pose.position, *pose.quaternion)
        owners.append([address, *fixed, width, kind.shell.rim_m])
        capsules += [
            [*capsule.start, *capsule.end, capsule.radius_m, float(number)]
            for capsule in kind.shell.capsules
        ]
    return np.array(owners).reshape(-1, 10), np.array(capsules).reshape(-1, 8)


@kernel
def find_obstacles(guard: Guard, records: np.ndarray, qpos: FloatArray) -> None:
    """See :meth:`SafetyFilter.look`."""
    owners, capsules, obstacles, objects = guard
    owners, capsules, qpos = borrowed(owners), borrowed(capsules), borrowed(qpos)
    obstacles, objects = borrowed(obstacles), borrowed(objects)
    for k in range(records.shape[0]):
        arm = records[k]
        q = qpos[arm.qpos : arm.qpos + 6]
        frames(arm.dh, arm.world_from_base, q, arm.placed)
        place_capsules(arm.placed, arm.parts[:, 7], arm.parts, arm.world)
        for i in range(CAPSULES):
            enclose(arm.world[i])
    for k in range(records.shape[0]):
        count = 0
        for other in range(records.shape[0]):
            if other == k:
                continue
            for i in range(CAPSULES):
                row, world = obstacles[k, count], records[other].world[i]
                for j in range(ROW):
                    if j != 7:
                        row[j] = world[j]
                count += 1
        _look_for_objects(records[k], owners, capsules, qpos, objects[k])


@kernel
def _look_for_objects(
    arm: np.record,
    owners: FloatArray,
    capsules: FloatArray,
    qpos: FloatArray,
    objects: FloatArray,
) -> None:
    """Write the objects outside the hand and those in it."""
    tcp = np.zeros(7)
    for i in range(3):
        tcp[i] = arm.placed[6, i, 3] + TCP_OFFSET_M * arm.placed[6, i, 2]
        tcp[3 + i] = tcp[i]
    width = qpos[arm.fingers[0]] + qpos[arm.fingers[1]]
    opening = min(max(width, 0.0), FINGER_OPENING_M)
    matrix = np.empty((3, 4))
    arm.beside, arm.inside = 0, 0
    c = 0
    for o in range(owners.shape[0]):
        address = int(owners[o, 0])
        transform(
            qpos[address : address + 7] if address >= 0 else owners[o, 1:8], matrix
        )
        first = arm.beside
        while c < capsules.shape[0] and capsules[c, 7] == o:
            row = objects[0, arm.beside]
            _place(matrix, capsules[c], row)
            enclose(row)
            arm.beside += 1
            c += 1
        for r in range(first, arm.beside):
            higher = max(objects[0, first, 2], objects[0, first, 5])
            objects[0, r, 7] = higher + owners[o, 9]
        # An object that cannot be gripped has NaN as its width.
        if not abs(opening - owners[o, 8]) < _GRIPPED_M:
            continue
        away = math.inf
        for r in range(first, arm.beside):
            row = objects[0, r]
            away = min(away, closest_points(tcp, row)[0] + row[6])
        if away < _HELD_M:
            for r in range(first, arm.beside):
                objects[1, arm.inside] = objects[0, r]
                arm.inside += 1
            arm.beside = first


@kernel
def transform(pose: FloatArray, out: FloatArray) -> None:
    """Write a position and a unit quaternion wxyz as a transform, (3, 4) or (4, 4)."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    out[0, 0] = 1 - 2 * (y * y + z * z)
    out[0, 1] = 2 * (x * y - w * z)
    out[0, 2] = 2 * (x * z + w * y)
    out[1, 0] = 2 * (x * y + w * z)
    out[1, 1] = 1 - 2 * (x * x + z * z)
    out[1, 2] = 2 * (y * z - w * x)
    out[2, 0] = 2 * (x * z - w * y)
    out[2, 1] = 2 * (y * z + w * x)
    out[2, 2] = 1 - 2 * (x * x + y * y)
    for i in range(3):
        out[i, 3] = pose[i]


@kernel
def _place(matrix: FloatArray, capsule: FloatArray, out: FloatArray) -> None:
    """Write ends and radius of a capsule in the world."""
    for end in range(2):
        x, y, z = capsule[3 * end], capsule[3 * end + 1], capsule[3 * end + 2]
        for i in range(3):
            out[3 * end + i] = (
                matrix[i, 3] + x * matrix[i, 0] + y * matrix[i, 1] + z * matrix[i, 2]
            )
    out[6] = capsule[6]
