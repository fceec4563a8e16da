"""Images of cameras in all worlds, ray-traced by MuJoCo Warp, as torch tensors."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from lemma.core.arguments import known
from lemma.core.poses import FloatArray, Pose, matrix_from_quaternion
from lemma.env.camera_rig import (
    WRIST_FOVY_RAD,
    camera_names,
    reach_name,
    wrist_mount,
    wrist_name,
)
from lemma.robots.gripper import TCP_OFFSET_M
from lemma.robots.ur.build import COLORS as ROBOT_SHELLS
from lemma.scene.camera_mounts import camera_mount, reach_mount
from lemma.scene.cameras import CameraIntrinsics
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.rendering.batch import VISIBLE_GROUPS, Poses
from lemma.scene.spec import SceneSpec
from lemma.warp.graphs import launched_if_possible

_FORWARD = np.array([1.0, -1.0, -1.0])
"""Signs of axes: in MuJoCo's camera frame the view is along -z, and y is up."""


class Pictures:
    """Color and depth of some cameras in all worlds of an environment.

    The mounts are those on the CPU: above each robot, above its reach, or on its wrist
    (:mod:`lemma.env.camera_rig`).
    """

    def __init__(
        self, env: Any, cameras: Sequence[str], width: int, height: int
    ) -> None:
        """Allocate buffers for all worlds.

        Args:
            env: A :class:`~lemma.warp.vector_env.GpuVecEnv`, whose tensors are read.
            cameras: Names of a robot, of its reach or of its wrist: ``"robot_0"``,
                ``"robot_0_reach"``, ``"robot_0_wrist"``.
            width: Width of images [px].
            height: Height of images [px].

        Raises:
            UnknownNameError: There is no such camera.
        """
        names = env.pool.scene.spec.robot_names
        fixed = (*names, *map(reach_name, names))
        valid = (*fixed, *map(wrist_name, names))
        self.cameras = tuple(known("camera", name, valid) for name in cameras)
        assert set(valid) <= set(camera_names(names))
        self._env, self._size = env, (width, height)
        self._make_places(names)
        self._make_colors()
        self._make_context()
        with wp.ScopedDevice(env.device):
            self._launch = launched_if_possible("pictures", self._trace, env.device)

    def _tensor(self, value: Any, kind: torch.dtype = torch.float32) -> Tensor:
        return torch.tensor(np.array(value), dtype=kind, device=self._env.device)

    def _make_places(self, names: Sequence[str]) -> None:
        env, count = self._env, len(self.cameras)
        wrists = list(map(wrist_name, names))
        mount = wrist_mount()
        turn = matrix_from_quaternion(mount.quaternion) * _FORWARD
        off = np.array(mount.position) - [0.0, 0.0, TCP_OFFSET_M]
        self._wrist_turn, self._wrist_off = self._tensor(turn), self._tensor(off)
        moves = [name in wrists for name in self.cameras]
        self._moves = self._tensor(moves, torch.bool)
        self._hand = self._tensor(
            [wrists.index(name) if name in wrists else 0 for name in self.cameras],
            torch.int64,
        )
        found = [
            [_mounted(one.scene, name, self._size)[0] for name in self.cameras]
            for one in env.pool.instances
        ]
        self._fixed = self._tensor(found)
        self._fovy_deg = [
            math.degrees(_mounted(env.pool.instances[0].scene, name, self._size)[1])
            for name in self.cameras
        ]
        with wp.ScopedDevice(env.device):
            self._camera_xpos = wp.zeros((env.num_envs, count), dtype=wp.vec3)
            self._camera_xmat = wp.zeros((env.num_envs, count), dtype=wp.mat33)

    def _make_colors(self) -> None:
        """Set the colors of robots' shells and of objects in each instance."""
        env, pool = self._env, self._env.pool
        scene, model = pool.scene, pool.scene.model
        rgba = model.geom_rgba.astype(np.float32)
        bodies = [int(model.body(name).id) for name in scene.object_names]
        painted: dict[int, int] = {}
        for geom, body in enumerate(model.geom_bodyid.tolist()):
            robot, _ = scene.parts[geom].tolist()
            if body in bodies:
                painted[geom] = len(scene.robots) + bodies.index(body)
            elif robot >= 0:
                shell = ROBOT_SHELLS[scene.spec.robots[robot].color]
                if np.allclose(rgba[geom], shell):
                    painted[geom] = robot
        self._geoms = self._tensor(list(painted), torch.int64)
        self._owner = self._tensor(list(painted.values()), torch.int64)
        colors = [
            [ROBOT_SHELLS[placed.color] for placed in one.scene.robots]
            + [OBJECT_COLORS[color] for color in of_slots]
            for one, of_slots in zip(pool.instances, pool.colors, strict=True)
        ]
        self._colors = self._tensor(colors)
        every = np.tile(rgba, (env.num_envs, 1, 1))
        self._rgba = wp.array(every, dtype=wp.vec4, device=env.device)

    def _make_context(self) -> None:
        env, count = self._env, len(self.cameras)
        data, n = env.data, env.num_envs
        with wp.ScopedDevice(env.device):
            self._context = mjw.create_render_context(
                env.pool.scene.model,
                nworld=n,
                cam_res=[self._size] * count,
                # Any camera: poses and fields of view are set at every launch.
                cam_active=[0] * count,
                render_rgb=[True] * count,
                render_depth=[True] * count,
                render_seg=[False] * count,
                use_textures=False,
                use_precomputed_rays=False,
                enabled_geom_groups=VISIBLE_GROUPS,
            )
            self._context.cam_id_map = wp.array(np.arange(count), dtype=int)
            self._model = replace(
                env.model,
                cam_projection=wp.zeros(count, dtype=int),
                cam_fovy=wp.array(
                    np.tile(self._fovy_deg, (n, 1)).astype(np.float32), dtype=float
                ),
                cam_sensorsize=wp.zeros(count, dtype=wp.vec2),
                cam_intrinsic=wp.zeros((1, count), dtype=wp.vec4),
                geom_rgba=self._rgba,
            )
            self._poses = Poses(
                nworld=n,
                geom_xpos=data.geom_xpos,
                geom_xmat=data.geom_xmat,
                cam_xpos=self._camera_xpos,
                cam_xmat=self._camera_xmat,
                light_xpos=data.light_xpos,
                light_xdir=data.light_xdir,
                flexvert_xpos=wp.empty((n, 0), dtype=wp.vec3),
            )

    def _trace(self) -> None:
        """Trace all rays, in Warp."""
        env = self._env
        # After a physics step the geoms' poses are those before the step.
        mjw.kinematics(env.model, env.data)
        mjw.camlight(env.model, env.data)
        mjw.refit_bvh(self._model, self._poses, self._context)
        mjw.render(self._model, self._poses, self._context)

    @torch.no_grad()
    def look(self) -> dict[str, dict[str, Tensor]]:
        """Return the present images.

        Returns:
            ``pixels``: by camera, (n, height, width, 3) uint8; ``depth``: by camera,
            (n, height, width) float32 [m].
        """
        env, n = self._env, self._env.num_envs
        rows = torch.where(
            self._moves[:, None], self._on_wrists(), self._fixed[env.instance]
        )
        wp.to_torch(self._camera_xpos).copy_(rows[..., :3])
        wp.to_torch(self._camera_xmat).copy_(rows[..., 3:].reshape(n, -1, 3, 3))
        colors = self._colors[env.instance][:, self._owner]
        wp.to_torch(self._rgba)[:, self._geoms] = colors
        self._launch()
        width, height = self._size
        shape = (n, len(self.cameras), height, width)
        packed = wp.to_torch(self._context.rgb_data.view(wp.int32))
        # Bytes are blue, green, red and opacity.
        rgb = packed.view(torch.uint8).view(*shape, 4)[..., :3].flip(-1)
        depth = wp.to_torch(self._context.depth_data).view(shape).clone()
        return {
            "pixels": {name: rgb[:, k] for k, name in enumerate(self.cameras)},
            "depth": {name: depth[:, k] for k, name in enumerate(self.cameras)},
        }

    def _on_wrists(self) -> Tensor:
        """Return the poses of cameras for mounts on wrists, (n, cameras, 12)."""
        hands = self._env.hands[:, self._hand]
        turn = hands[..., 3:].view(*hands.shape[:2], 3, 3)
        at = hands[..., :3] + (turn * self._wrist_off).sum(-1)
        seen = (turn[..., None] * self._wrist_turn).sum(-2)
        return torch.cat([at, seen.flatten(-2)], -1)


def _mounted(
    spec: SceneSpec, name: str, size: tuple[int, int]
) -> tuple[FloatArray, float]:
    """Return position and rotation, 12 numbers, and the vertical field of view [rad].

    The pose is not used for a camera on a wrist.
    """
    for robot, placed in zip(spec.robot_names, spec.robots, strict=True):
        if name == robot:
            mount, fovy = camera_mount(placed)
            return _row(mount), fovy
        if name == reach_name(robot):
            mount, fov = reach_mount(placed)
            lens = CameraIntrinsics.from_shorter_side(fov, *size)
            return _row(mount), lens.fovy_rad
    return np.zeros(12), WRIST_FOVY_RAD


def _row(mount: Pose) -> FloatArray:
    turn = matrix_from_quaternion(mount.quaternion) * _FORWARD
    return np.array([*mount.position, *turn.ravel()])
