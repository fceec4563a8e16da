"""The physics of many worlds in MuJoCo Warp, and its memory as torch tensors."""

from typing import Any

import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from lemma.core.errors import PhysicsError
from lemma.env.control.guarded_arm import SPEED_FRACTION
from lemma.policies.control.hand_steps import Arms
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.warp.graphs import launched
from lemma.warp.hands import hand_poses, upright
from lemma.warp.instances import Pool
from lemma.warp.kernels import drive, follow, note

_LOST = (
    mjw.OverflowType.NEFC | mjw.OverflowType.NARROWPHASE | mjw.OverflowType.BROADPHASE
)


class Worlds:
    """Worlds of one model; the base of :class:`~lemma.warp.vector_env.GpuVecEnv`."""

    pool: Pool
    num_envs: int
    device: str
    _substeps: int

    def _make_worlds(self) -> None:
        self._make_physics()
        self._make_memory()
        self._make_constants()
        self._capture()

    def _make_physics(self) -> None:
        scene, n = self.pool.scene, self.num_envs
        self.robots, movable = scene.robots, len(scene.movable_names)
        with wp.ScopedDevice(self.device):
            batch = dict.fromkeys(("body_pos", "body_quat", "body_gravcomp"), n)
            self.model = mjw.put_model(scene.model, batch_sizes=batch)
            self.model.opt.warn_overflow = 0
            self.data = mjw.make_data(
                scene.model,
                nworld=n,
                nconmax=16 * (len(self.robots) + movable),
                njmax=48 * len(self.robots) + 64 * movable,
            )
        self._rows = {
            key: torch.tensor(value, dtype=torch.float32, device=self.device)
            for key, value in self.pool.rows.items()
        }
        view = wp.to_torch
        model, data = self.model, self.data
        self.qpos, self.qvel, self.ctrl = (
            view(a) for a in (data.qpos, data.qvel, data.ctrl)
        )
        self._warm, self._overflow = view(data.qacc_warmstart), view(data.overflow)
        self._bodies = {
            "body_pos": view(model.body_pos),
            "body_quat": view(model.body_quat),
        }
        self._gravcomp = view(model.body_gravcomp)
        self._geoms = {
            "geom_xpos": view(data.geom_xpos),
            "geom_xmat": view(data.geom_xmat).view(n, -1, 9),
        }

    def _make_memory(self) -> None:
        scene, n, device = self.pool.scene, self.num_envs, self.device
        count, slots = len(self.robots), len(self.pool.slots)
        arms = [robot.arm for robot in self.robots]
        self.arms = Arms.of([arm.name for arm in arms], device)
        self.joint_at = torch.tensor(
            [[*range(r.qpos.start, r.qpos.stop)] for r in self.robots], device=device
        )
        ranges = [list(arm.joint_range) for arm in arms]
        self.joint_range = torch.tensor(ranges, dtype=torch.float32, device=device)
        self._make_places()

        def zeros(*shape: int, dtype: Any = torch.float32) -> Tensor:
            return torch.zeros(shape, dtype=dtype, device=device)

        self.angle, self.rate = zeros(n, 6 * count), zeros(n, 6 * count)
        self._wanted = zeros(n, 6 * count)
        self.hands, self.aim = zeros(n, count, 12), zeros(n, count, 12)
        self.target, self.base = zeros(n, count, 4), zeros(n, count, 3)
        self.touch = zeros(n, slots, 3, dtype=torch.int32)
        self._left = zeros(n, len(scene.movable_names), 3)
        self._awake, self._thrown = (zeros(n, dtype=torch.int32) for _ in range(2))
        self.instance, self._age, self._settled = (
            zeros(n, dtype=torch.int64) for _ in range(3)
        )
        self.potential, self._slow = zeros(n), zeros(n, count, 1)

    def _make_places(self) -> None:
        """Create index tensors on the device; each use of a list would copy it."""
        pool, robots = self.pool, self.robots
        free = [pool.scene.qpos_of(name) for name in pool.scene.movable_names]
        places = {
            "fingers": [list(r.finger_qpos) for r in robots],
            "dofs": [[*range(r.dof.start, r.dof.stop + 2)] for r in robots],
            "grips": [r.gripper_ctrl for r in robots],
            "numbers": [*range(len(robots))],
            "motors": [[*range(r.ctrl.start, r.ctrl.stop)] for r in robots],
            "moved": list(pool.moved),
            "geoms": list(pool.geoms),
            "free": [[at, at + 1] for at in free],
        }
        self._at = {
            key: torch.tensor(value, dtype=torch.int64, device=self.device)
            for key, value in places.items()
        }

    def _make_constants(self) -> None:
        scene, device = self.pool.scene, self.device
        arms = [robot.arm for robot in self.robots]
        numbers = [
            (SPEED_FRACTION * arm.velocity_limits[i], arm.lag_s, arm.joint_range[i])
            for arm in arms
            for i in range(6)
        ]
        places = [
            (r.qpos.start + i, r.ctrl.start + i) for r in self.robots for i in range(6)
        ]
        free = [
            (scene.qpos_of(name), int(scene.model.joint(name).dofadr[0]))
            for name in scene.movable_names
        ]
        owner = self._owners()
        self._constants = tuple(
            wp.array(value, dtype=kind, device=device)
            for value, kind in (
                (numbers, float),
                (places, int),
                (free, int),
                (owner, int),
            )
        )

    def _owners(self) -> list[int]:
        """Return the owner of each geom; see :func:`lemma.warp.kernels.note`."""
        scene = self.pool.scene
        slots = {name: k for k, name in enumerate(scene.object_names)}
        found = []
        for geom in range(scene.model.ngeom):
            body = scene.model.body(int(scene.model.geom_bodyid[geom])).name
            robot, bit = scene.parts[geom].tolist()
            part = {2: 1, 4: 2}.get(bit, 0)
            own = 1 + len(slots) + 3 * robot + part if robot >= 0 else 0
            found.append(1 + slots[body] if body in slots else own)
        return found

    def _advance(self) -> None:
        """Advance the physics by one control step, in Warp."""
        numbers, places, free, _ = self._constants
        data, n, slots = self.data, self.num_envs, len(self.pool.slots)
        movable = len(self.pool.scene.movable_names)
        robots = sum(1 << (1 + slots + k) for k in range(3 * len(self.robots)))
        room = 1 + sum(1 << (1 + k) for k in range(movable, slots))
        for _ in range(self._substeps):
            wp.launch(
                drive,
                (n, 6 * len(self.robots)),
                [data.qpos, wp.from_torch(self._wanted), numbers, places,
                 wp.from_torch(self.angle), wp.from_torch(self.rate), data.ctrl],
            )  # fmt: skip
            mjw.step(self.model, data)
            self._note_touches()
            wp.launch(
                follow,
                n,
                [data.qpos, data.qvel, free, robots, room, wp.from_torch(self.touch),
                 wp.from_torch(self._left), wp.from_torch(self._awake),
                 wp.from_torch(self._thrown)],
            )  # fmt: skip

    def _note_touches(self) -> None:
        """Record contacts of the last physics step by owner, in Warp."""
        owner, contact = self._constants[-1], self.data.contact
        touch = wp.from_torch(self.touch)
        touch.zero_()
        wp.launch(
            note,
            self.data.naconmax,
            [self.data.nacon, contact.worldid, contact.geom, contact.frame, owner,
             len(self.pool.slots), touch],
        )  # fmt: skip

    def _capture(self) -> None:
        self._simulate = launched(self._advance, self.device)
        # The recorded step was of worlds without an initial state.
        self._overflow.zero_()

    def _place_hands(self) -> None:
        self.hands.copy_(hand_poses(self.qpos[:, self.joint_at], self.base, self.arms))

    @property
    def here(self) -> Tensor:
        """Poses of the hands: x, y, z, yaw, (n, robots, 4) [m, rad]."""
        return upright(self.hands)

    @property
    def opening(self) -> Tensor:
        """Distance between the fingers of each hand, (n, robots) [m]."""
        fingers = self.qpos[:, self._at["fingers"]]
        found: Tensor = fingers.sum(-1).clamp(0.0, FINGER_OPENING_M)
        return found

    @property
    def asked(self) -> Tensor:
        """The last commanded opening of each gripper, (n, robots) [m]."""
        found: Tensor = self.ctrl[:, self._at["grips"]]
        return found

    def check(self) -> None:
        """Check the buffers of the physics.

        Raises:
            PhysicsError: A buffer was too small, and contacts were lost.
        """
        lost = (self._overflow & int(_LOST)) != 0
        if bool(lost.any()):
            raise PhysicsError(
                f"Contacts or constraints of {int(lost.sum())} worlds did not fit into "
                "their buffers, so their simulation is wrong."
            )
