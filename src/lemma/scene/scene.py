"""A compiled scene: physics, with access to objects and robots by name."""

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import memory_of, mujoco
from lemma.core.errors import PhysicsError, UnknownNameError
from lemma.core.poses import FloatArray, Pose, Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.ur.build import ARMS, JOINTS, ArmSpec
from lemma.scene.build import compile_model
from lemma.scene.coasting import Coasting, Physics
from lemma.scene.objects.bodies import resting_quaternion
from lemma.scene.objects.contacts import (
    LEFT,
    RIGHT,
    ForbiddenContacts,
    parts_of_robots,
)
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class RobotIndex:
    """Addresses of one robot in the model's arrays."""

    name: str
    placement: RobotPlacement
    arm: ArmSpec
    qpos: slice
    """Joint positions in ``data.qpos``."""
    dof: slice
    """Joint velocities in ``data.qvel``."""
    ctrl: slice
    """Servos in ``data.ctrl``."""
    gripper_ctrl: int
    finger_qpos: tuple[int, int]
    world_from_base: FloatArray
    """(4, 4) [m]."""


class Scene:
    """A compiled model with its data, and access by name.

    Positions are computed from generalised coordinates, not from derived quantities, so
    they are up to date directly after a step.
    """

    def __init__(self, spec: SceneSpec, actuation: str = "position") -> None:
        """Compile a scene and set its initial state.

        Args:
            spec: The scene.
            actuation: ``"position"``, ``"velocity"`` or ``"torque"``.

        Raises:
            UnknownNameError: No such actuation.
        """
        self.spec = spec
        self.actuation = actuation
        self.model = compile_model(spec, actuation)
        self.data = mujoco.MjData(self.model)
        self.robots = tuple(
            self._index_robot(name, placement)
            for name, placement in zip(spec.robot_names, spec.robots, strict=True)
        )
        self._free_qpos = {
            placed.name: int(self.model.joint(placed.name).qposadr[0])
            for placed in spec.objects
            if not placed.entity.kind.fixed
        }
        self._free_dof = {
            name: int(self.model.joint(name).dofadr[0]) for name in self._free_qpos
        }
        # Views are kept, because creating them at every access would take noticeable
        # time.
        self._qpos: FloatArray = self.data.qpos
        self._qvel: FloatArray = self.data.qvel
        self._fixed_poses = {
            placed.name: _lying(placed)
            for placed in spec.objects
            if placed.entity.kind.fixed
        }
        self.object_names = spec.object_names
        """Names of the entities on the table."""
        self.kinds = {placed.name: placed.entity.kind for placed in spec.objects}
        """Kind of each entity on the table, by name."""
        self._rows = {name: self._view_row(name) for name in self.object_names}
        self._entity_by_body = {
            self.model.body(placed.name).id: placed.name for placed in spec.objects
        }
        self._state_size = mujoco.mj_stateSize(self.model, _STATE)
        self.coasting = Coasting(self.model, self.data)
        """Tracks objects that move without a robot."""
        self.forbidden = ForbiddenContacts(self.coasting.owner, self.parts[:, 0])
        """Contacts that a rule forbids."""
        self.physics: Physics = (
            *memory_of(self.model, self.data),
            *(self.coasting.owner, self.coasting.flags, self.coasting.objects),
            *(self.forbidden.who, self.forbidden.bad, self.forbidden.first),
            *(self._qpos, self._qvel, self.data.ctrl),
        )
        """All that kernels need to advance the physics; valid while this scene
        exists."""

    def check_memory(self) -> None:
        """Check that kernels see time and contacts where MuJoCo has them.

        Raises:
            PhysicsError: This version of MuJoCo has them elsewhere.
        """
        _, time, count, *_ = self.physics
        if (time[0], count[0]) != (self.data.time, self.data.ncon):
            raise PhysicsError(
                f"MuJoCo {mujoco.__version__} keeps its state in another way. Install "
                "the version that this package requires."
            )

    def _index_robot(self, name: str, placement: RobotPlacement) -> RobotIndex:
        model = self.model
        qpos = [int(model.joint(f"{name}/{joint}").qposadr[0]) for joint in JOINTS]
        dof = [int(model.joint(f"{name}/{joint}").dofadr[0]) for joint in JOINTS]
        ctrl = [int(model.actuator(f"{name}/{joint}").id) for joint in JOINTS]
        fingers = [
            int(model.joint(f"{name}/finger_{side}").qposadr[0])
            for side in ("left", "right")
        ]
        base = placement.base.matrix()
        return RobotIndex(
            name=name,
            placement=placement,
            arm=ARMS[placement.arm],
            qpos=slice(qpos[0], qpos[0] + 6),
            dof=slice(dof[0], dof[0] + 6),
            ctrl=slice(ctrl[0], ctrl[0] + 6),
            gripper_ctrl=int(model.actuator(f"{name}/gripper").id),
            finger_qpos=(fingers[0], fingers[1]),
            world_from_base=base,
        )

    @property
    def time_s(self) -> float:
        """Simulated time since the initial state [s]."""
        return float(self.data.time)

    def robot(self, name: str) -> RobotIndex:
        """Return the robot called ``name``.

        Raises:
            UnknownNameError: There is no such robot in this scene.
        """
        for robot in self.robots:
            if robot.name == name:
                return robot
        raise UnknownNameError("robot in this scene", name, self.spec.robot_names)

    @property
    def movable_names(self) -> tuple[str, ...]:
        """Names of the objects that are not fixed to the table."""
        return tuple(self._free_qpos)

    def pose(self, name: str) -> Pose:
        """Return the pose of an object's body frame in the world.

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        address = self._free_qpos.get(name)
        if address is None:
            if name not in self._fixed_poses:
                raise self._unknown(name)
            return self._fixed_poses[name]
        q = self._qpos[address : address + 7].tolist()
        return Pose((q[0], q[1], q[2]), (q[3], q[4], q[5], q[6]))

    def _unknown(self, name: str) -> UnknownNameError:
        return UnknownNameError("object in this scene", name, self.spec.object_names)

    def pose_row(self, name: str) -> FloatArray:
        """Return position [m] and quaternion wxyz of an object, (7,).

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        if name not in self._rows:
            raise self._unknown(name)
        return self._rows[name].copy()

    def pose_rows(self) -> dict[str, FloatArray]:
        """Return :meth:`pose_row` of every object, by name."""
        return {name: row.copy() for name, row in self._rows.items()}

    def _view_row(self, name: str) -> FloatArray:
        """Return the array that :meth:`pose_row` copies: a view of ``data.qpos``."""
        address = self._free_qpos.get(name)
        if address is not None:
            return self._qpos[address : address + 7]
        pose = self._fixed_poses[name]
        return np.array((*pose.position, *pose.quaternion))

    def qpos_of(self, name: str) -> int:
        """Return the address of an object's pose in ``data.qpos``; -1 if fixed."""
        return self._free_qpos.get(name, -1)

    def position(self, name: str) -> list[float]:
        """Return the world position of an object's body frame, (3,) [m].

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        address = self._free_qpos.get(name)
        if address is None:
            return list(self.pose(name).position)
        found: list[float] = self._qpos[address : address + 3].tolist()
        return found

    def pose2(self, name: str) -> Pose2:
        """Return the planar pose of an object; the yaw is that of its x axis.

        Raises:
            UnknownNameError: There is no such object in this scene.
        """
        pose = self.pose(name)
        w, x, y, z = pose.quaternion
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return Pose2(pose.position[0], pose.position[1], yaw)

    def set_pose(self, name: str, pose: Pose) -> None:
        """Set the pose of a movable object, at rest.

        Raises:
            UnknownNameError: There is no such movable object in this scene.
        """
        address = self._free_qpos.get(name)
        if address is None:
            raise UnknownNameError("movable object", name, self._free_qpos)
        self._qpos[address : address + 3] = pose.position
        self._qpos[address + 3 : address + 7] = pose.quaternion
        dof = self._free_dof[name]
        self._qvel[dof : dof + 6] = 0.0
        self.coasting.put(name)

    def speed(self, name: str) -> float:
        """Return the linear speed of an object [m/s]; 0 if it is fixed."""
        dof = self._free_dof.get(name)
        if dof is None:
            return 0.0
        vx, vy, vz = self._qvel[dof : dof + 3].tolist()
        return math.sqrt(vx * vx + vy * vy + vz * vz)

    def turn_rate(self, name: str) -> float:
        """Return the angular speed of an object [rad/s]; 0 if it is fixed."""
        dof = self._free_dof.get(name)
        if dof is None:
            return 0.0
        wx, wy, wz = self._qvel[dof + 3 : dof + 6].tolist()
        return math.sqrt(wx * wx + wy * wy + wz * wz)

    @property
    def fallen(self) -> tuple[str, ...]:
        """Names of the objects that have fallen off the table.

        Their centre of mass is below its top, where no skill can reach.
        """
        return self.coasting.fallen

    def set_joints(self, robot: RobotIndex, q: FloatArray, opening_m: float) -> None:
        """Set one arm and its servos to joint angles ``q``, (6,) [rad], at rest.

        Args:
            robot: The robot.
            q: Joint angles, (6,) [rad].
            opening_m: Distance between the finger pads [m].
        """
        self.data.qpos[robot.qpos] = q
        self.data.qvel[robot.dof] = 0.0
        for address in robot.finger_qpos:
            self.data.qpos[address] = opening_m / 2
        self.data.ctrl[robot.ctrl] = q if self.actuation == "position" else 0.0
        self.data.ctrl[robot.gripper_ctrl] = opening_m

    def opening_m(self, robot: RobotIndex) -> float:
        """Return the measured distance between the finger pads [m]."""
        left, right = robot.finger_qpos
        width = float(self.data.qpos[left]) + float(self.data.qpos[right])
        return min(max(width, 0.0), FINGER_OPENING_M)

    def opening_m_s(self, robot: RobotIndex) -> float:
        """Return the measured rate of the distance between the finger pads [m/s]."""
        left, right = self.data.qvel[robot.dof.stop : robot.dof.stop + 2].tolist()
        return float(left + right)

    def entity_of_body(self, body: int) -> str | None:
        """Return the entity that a MuJoCo body belongs to, if any."""
        return self._entity_by_body.get(body)

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse copies: their kernels would write into the memory of this scene."""
        raise TypeError(
            "A scene, and what contains one, such as an environment or an episode, "
            "cannot be copied or pickled. Restore a snapshot() in another one."
        )

    def snapshot(self) -> FloatArray:
        """Return MuJoCo's full integration state, (n,), for bit-exact continuation."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def restore(self, state: FloatArray) -> None:
        """Set the full integration state that :meth:`snapshot` returned."""
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        self.refresh()

    def refresh(self) -> None:
        """Update derived poses, for rendering; the integration state is unchanged."""
        _derive(self.model, self.data)

    def posed(self, qpos: FloatArray) -> mujoco.MjData:
        """Return separate data with derived poses of another state, for rendering.

        Args:
            qpos: Positions of all joints, (nq,).

        Returns:
            The data, valid until the next call.
        """
        self._posed.qpos[:] = qpos
        _derive(self.model, self._posed)
        return self._posed

    @cached_property
    def parts(self) -> NDArray[np.int64]:
        """Robot and part of each geom; see :func:`.contacts.parts_of_robots`."""
        return parts_of_robots(self.model, [robot.name for robot in self.robots])

    def held(self) -> dict[str, str]:
        """Return the held entities by robot.

        An object is held if both finger pads of a gripper touch it.
        """
        contacts, parts = self.data.contact.geom, self.parts
        touching: dict[tuple[int, str], int] = {}
        # This runs in every step, so filter first: few contacts involve pads.
        for contact, side in np.argwhere(parts[contacts, 1] >= LEFT).tolist():
            robot, pad = parts[contacts[contact, side]].tolist()
            body = self.model.geom_bodyid[contacts[contact, 1 - side]]
            entity = self.entity_of_body(int(body))
            if entity is not None:
                touching[robot, entity] = touching.get((robot, entity), 0) | pad
        names, both = self.spec.robot_names, LEFT | RIGHT
        return {
            names[r]: thing for (r, thing), pads in touching.items() if pads == both
        }

    @cached_property
    def tcp_sites(self) -> NDArray[np.int64]:
        """Index of the site at each robot's tool centre point, (robots,)."""
        return np.array([self.model.site(f"{r.name}/tcp").id for r in self.robots])

    @cached_property
    def _posed(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def state_hash(self) -> str:
        """Return the SHA-256 of the full integration state."""
        return hashlib.sha256(self.snapshot().tobytes()).hexdigest()


def _lying(placed: ObjectPlacement) -> Pose:
    """Return the initial pose of an object's body frame in the world."""
    x, y = placed.pose.xy
    position = (x, y, placed.entity.kind.origin_m)
    return Pose(position, resting_quaternion(placed.pose.yaw))


def _derive(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Compute the poses of bodies, cameras and lights."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
