"""Obstacles of an arm: the other arms, and the objects on the table."""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, Pose2
from lemma.motion.arm_motion import ArmMotion
from lemma.robots.collision_model import envelope_of, place_capsules
from lemma.robots.ur.kinematics import frames
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene

_ARM_RANGE_M = 0.15
_OBJECT_RANGE_M = 0.05
_WORK_AREA_M = 0.16
"""Radius around the target within which objects are no obstacles: the gripper comes
straight from above, between them, and their repulsion would make it miss."""

_ARM = np.dtype(
    [
        ("qpos", np.int64),
        ("dh", np.float64, 6),
        ("base", np.float64, (4, 4)),
        ("links", np.float64, 10),
        ("capsules", np.float64, (10, 7)),
    ]
)
_THING = np.dtype(
    [
        # Address of its pose in ``data.qpos``; -1 for a fixed object, with ``pose``.
        ("qpos", np.int64),
        ("pose", np.float64, 7),
        ("name", np.int64),
        ("capsule", np.float64, 7),
    ]
)


class Obstacles:
    """Obstacles of the arms of one scene, at their present positions."""

    def __init__(self, arms: Mapping[str, ArmMotion]) -> None:
        """Collect the capsules of arms and objects.

        Args:
            arms: Motion of every robot of the scene, by robot name.
        """
        scene = next(iter(arms.values())).scene
        self._qpos = scene.data.qpos
        self._numbers = {name: k for k, name in enumerate(arms)}
        self._arms = np.array([_arm_record(arm) for arm in arms.values()], _ARM)
        self._names = {name: k for k, name in enumerate(scene.object_names)}
        things = [
            row
            for name, number in self._names.items()
            for row in _records(scene, name, number)
        ]
        self._things = np.array(things, _THING)
        rows = 10 * (len(self._arms) - 1) + len(self._things)
        self._rows = np.empty((len(self._arms), rows, 8))
        self.felt: dict[str, tuple[Pose2 | None, str | None]] = {}
        """Target and held object that are left out of each robot's obstacles."""

    def feel(self, arm: ArmMotion, target: Pose2 | None, held: str | None) -> None:
        """Set the obstacles of an arm; see :meth:`around`."""
        self.felt[arm.robot.name] = (target, held)
        arm.set_obstacles(self.around(arm.robot.name, target, held))

    def around(self, robot: str, target: Pose2 | None, held: str | None) -> FloatArray:
        """Return the obstacles of one arm.

        Args:
            robot: The robot that moves; its own arm is left out.
            target: Where it will work; objects near it are left out. None: nowhere.
            held: The object that it holds or will pick up, which is left out.

        Returns:
            Both ends, radius and range of capsules, (n, 8) [m]. Beyond its range an
            obstacle has no effect. The array is valid until the next call for this
            robot.
        """
        me = self._numbers[robot]
        x, y = (math.inf, math.inf) if target is None else target.xy
        out, lifted = self._rows[me], -1 if held is None else self._names[held]
        count = _gather(self._qpos, self._arms, self._things, me, lifted, x, y, out)
        rows: FloatArray = out[:count]
        return rows


def _arm_record(arm: ArmMotion) -> tuple[object, ...]:
    robot, envelope = arm.robot, envelope_of(arm.robot.arm.name)
    base, shape = robot.world_from_base, (envelope.capsule_links, envelope.capsules)
    return (robot.qpos.start, robot.arm.dh, base, *shape)


def _records(scene: Scene, name: str, number: int) -> list[tuple[object, ...]]:
    """Return the records of an object's capsules."""
    address = scene.qpos_of(name)
    pose = scene.pose_row(name)
    return [
        (address, pose, number, (*capsule.start, *capsule.end, capsule.radius_m))
        for capsule in kind_of(name).obstacle
    ]


@kernel
def _gather(  # noqa: PLR0913 - one call is what makes it fast
    qpos: FloatArray,
    arms: npt.NDArray[np.void],
    things: npt.NDArray[np.void],
    me: int,
    lifted: int,
    x: float,
    y: float,
    out: FloatArray,
) -> int:
    """Write the obstacles of an arm to ``out``, (n, 8) [m]; return their number.

    Args:
        qpos: MuJoCo's ``qpos`` of the scene.
        arms: Records of all arms.
        things: Records of the capsules of all objects.
        me: Index of the arm.
        lifted: Index of the object that it holds, or -1.
        x: World x of its target [m]; infinite without one.
        y: World y of its target [m]; infinite without one.
        out: Written.
    """
    count, placed, pose = 0, np.empty((7, 4, 4)), np.empty(7)
    for k in range(arms.shape[0]):
        if k != me:
            arm = arms[k]
            start, shape = arm.qpos, arm.capsules
            frames(arm.dh, arm.base, qpos[start : start + 6], placed)
            place_capsules(placed, arm.links, shape, out[count:])
            for i in range(count, count + shape.shape[0]):
                out[i, 7] = _ARM_RANGE_M
            count += shape.shape[0]
    for k in range(things.shape[0]):
        thing = things[k]
        if thing.name == lifted:
            continue
        start = thing.qpos
        for i in range(7):
            pose[i] = qpos[start + i] if start >= 0 else thing.pose[i]
        qw, qx, qy, qz = pose[3], pose[4], pose[5], pose[6]
        yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        cos, sin = math.cos(yaw), math.sin(yaw)
        row, shape = out[count], thing.capsule
        for i in (0, 3):
            row[i] = pose[0] + cos * shape[i] - sin * shape[i + 1]
            row[i + 1] = pose[1] + sin * shape[i] + cos * shape[i + 1]
            row[i + 2] = pose[2] + shape[i + 2]
        row[6], row[7] = shape[6], _OBJECT_RANGE_M
        if math.isinf(x) or _gap(row, x, y) > _WORK_AREA_M:
            count += 1
    return count


@kernel
def _gap(capsule: FloatArray, x: float, y: float) -> float:
    """Return the horizontal distance between a capsule's axis and a position [m]."""
    ax, ay = capsule[0], capsule[1]
    dx, dy = capsule[3] - ax, capsule[4] - ay
    length = dx * dx + dy * dy
    t = 0.0
    if length > 0.0:
        t = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length))
    return math.hypot(x - ax - t * dx, y - ay - t * dy)
