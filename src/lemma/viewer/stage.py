"""The scene on the page: bodies, light, names, and what can be laid over them."""

import math
from typing import Any

import numpy as np
import viser

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.viewer.shapes import shapes_of
from lemma.viz.annotate import ROBOT_INK
from lemma.viz.recording import robot_titles

OVERLAYS = {
    "names": "Robots and objects, as sentences call them.",
    "reach": "Where a robot surely works (solid), what it could touch (dashed).",
    "contacts": "Where things touch.",
}
"""What may be laid over the scene."""
_TARGET_M = np.array([0.0, -0.05, 0.05])
"""Where a visitor looks at first [m]."""
_FROM = np.array([0.0, -0.81, 0.59])
_UP = np.array([0.0, 0.59, 0.81])
_FOV_RAD = math.radians(40.0)
_PHONE_PX, _PANEL_PX = 760, 390
_COVERED = 0.55
_HALF_HEIGHT_M, _BESIDE_M = 0.9, 0.5
"""What shall be seen at least on either side, and beside each robot [m]."""
_MOVED_M = 1e-5
_POINTS = 96
_OVER_TABLE_M = 0.004
_MOST_CONTACTS = 40
_CONTACT_RGB = (255, 140, 0)


class Stage:
    """Nodes of one scene in a page, for all of its tabs."""

    def __init__(self, server: viser.ViserServer, visible: set[str]) -> None:
        """Light an empty room.

        Args:
            server: The page.
            visible: Those of :data:`OVERLAYS` that are to be seen.
        """
        self._server, self._visible = server, set(visible)
        self.bodies: dict[int, Any] = {}
        """Nodes by number of the body."""
        self._shown: dict[int, FloatArray] = {}
        self.overlays: dict[str, list[Any]] = {name: [] for name in OVERLAYS}
        """Nodes of each overlay."""
        self._data: mujoco.MjData | None = None
        self._scene: Scene | None = None
        self._contacts: Any = None
        self._half_width_m = 1.0
        server.initial_camera.position = eye_for(1.5, self._half_width_m)
        server.initial_camera.look_at = _TARGET_M
        server.initial_camera.fov = _FOV_RAD
        self._fitted: dict[int, float] = {}

    def set_scene(self, scene: Scene, instance: Instance) -> None:
        """Show another scene; what is the same table stays as it is.

        Args:
            scene: Its model is drawn, its data are left alone.
            instance: Of it.
        """
        known = self._scene is not None and self._scene.spec == scene.spec
        self._scene, self._data = scene, mujoco.MjData(scene.model)
        if known:
            return
        with self._server.atomic():
            self._server.scene.reset()
            self.bodies, self._shown = {}, {}
            self._light()
            self._draw_bodies(scene)
            for handles in self.overlays.values():
                handles.clear()
            self._draw_names(instance)
            self._draw_reach(instance)
            self._draw_contacts()
        half_m = max(abs(r.base.x) for r in instance.scene.robots) + _BESIDE_M
        if half_m > self._half_width_m or half_m < self._half_width_m - _BESIDE_M:
            self._half_width_m = half_m
            self._server.initial_camera.position = eye_for(1.5, half_m)

    def step_back(self) -> None:
        """Let visitors see all robots, however narrow their windows: once a table."""
        visitors = self._server.get_clients()
        half_m = self._half_width_m
        for number, client in visitors.items():
            if self._fitted.get(number) != half_m:
                width, height = client.camera.image_width, client.camera.image_height
                if width > _PHONE_PX:
                    # The panel docks later.
                    width -= _PANEL_PX
                eye = eye_for(width / max(height, 1), half_m)
                down = 0.0
                if width <= _PHONE_PX < height:
                    # The panel covers what is below.
                    away = float(np.linalg.norm(eye - _TARGET_M))
                    down = _COVERED * away * math.tan(_FOV_RAD / 2.0)
                client.camera.position = eye - down * _UP
                client.camera.look_at = _TARGET_M - down * _UP
        self._fitted = dict.fromkeys(visitors, half_m)

    def _light(self) -> None:
        scene = self._server.scene
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere(
            "/light/sky",
            sky_color=(255, 255, 255),
            ground_color=(170, 175, 185),
            intensity=0.8,
        )
        # Looks along its negative z axis from where it is to the origin.
        scene.add_light_directional(
            "/light/sun", intensity=1.25, cast_shadow=True, position=(-1.2, -1.6, 3.2)
        )
        scene.add_light_directional(
            "/light/fill", intensity=0.3, position=(2.5, 1.0, 2.0)
        )

    def _draw_bodies(self, scene: Scene) -> None:
        model, root = scene.model, self._server.scene
        for number, shape in enumerate(shapes_of(model)):
            name = f"/world/{model.body(shape.body).name}"
            if shape.body not in self.bodies:
                self.bodies[shape.body] = root.add_frame(name, show_axes=False)
            root.add_mesh_simple(
                f"{name}/part_{number}",
                shape.vertices,
                shape.faces,
                color=shape.rgb,
                cast_shadow=not shape.endless,
                receive_shadow=0.35,
            )

    def _draw_names(self, instance: Instance) -> None:
        titles = zip(instance.scene.robot_names, robot_titles(instance), strict=True)
        labels = [(f"{name}/base", title, -0.12) for name, title in titles]
        for name in instance.scene.object_names:
            labels.append((name, entity_named(name).phrase, 0.06))
        for body, text, height_m in labels:
            self._keep(
                "names",
                self._server.scene.add_label(
                    f"/world/{body}/name",
                    text,
                    position=(0.0, 0.0, height_m),
                    anchor="bottom-center",
                    font_screen_scale=0.75,
                    visible="names" in self._visible,
                ),
            )

    def _draw_reach(self, instance: Instance) -> None:
        """Draw where each robot works, solid, and what it could touch, dashed."""
        names = instance.scene.robot_names
        for name, placed in zip(names, instance.scene.robots, strict=True):
            reach, could = reach_of(placed.arm), could_of(placed.arm)
            rings = (
                ("travel", reach.travel_m, 1),
                ("inner", reach.inner_m, 1),
                ("touch", could.touch_m, 2),
            )
            for what, radius_m, every in rings:
                handle = self._server.scene.add_line_segments(
                    f"/reach/{name}/{what}",
                    _ring(placed.base.x, placed.base.y, radius_m, every),
                    ROBOT_INK[placed.color][:3],
                    thickness=3.0 if every == 1 else 2.0,
                    thickness_units="screen",
                    visible="reach" in self._visible,
                )
                self._keep("reach", handle)

    def _draw_contacts(self) -> None:
        self._contacts = self._server.scene.add_point_cloud(
            "/contacts",
            np.zeros((0, 3), np.float32),
            _CONTACT_RGB,
            point_size=0.012,
            point_shape="circle",
            visible="contacts" in self._visible,
        )
        self._keep("contacts", self._contacts)

    def _keep(self, overlay: str, handle: Any) -> None:
        self.overlays[overlay].append(handle)

    def set_visible(self, overlay: str, visible: bool) -> None:
        """Show or hide one of :data:`OVERLAYS`."""
        (self._visible.add if visible else self._visible.discard)(overlay)
        for handle in self.overlays[overlay]:
            handle.visible = visible

    def show(self, qpos: FloatArray) -> int:
        """Put all bodies where they are, and send what has moved.

        Args:
            qpos: Positions of all joints, (nq,).

        Returns:
            How many bodies were moved.
        """
        if self._scene is None or self._data is None:
            return 0
        model, data, moved = self._scene.model, self._data, 0
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        with self._server.atomic():
            for body, handle in self.bodies.items():
                pose = np.concatenate([data.xpos[body], data.xquat[body]])
                shown = self._shown.get(body)
                if shown is None or np.abs(shown - pose).max() > _MOVED_M:
                    handle.position, handle.wxyz = pose[:3], pose[3:]
                    self._shown[body] = pose
                    moved += 1
            if "contacts" in self._visible:
                self._show_contacts(model, data)
        return moved

    def _show_contacts(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        mujoco.mj_fwdPosition(model, data)
        points = data.contact.pos[: min(data.ncon, _MOST_CONTACTS)]
        self._contacts.points = np.asarray(points, np.float32).reshape(-1, 3)


def eye_for(aspect: float, half_width_m: float) -> FloatArray:
    """Return where to stand to see the table, (3,) [m].

    Args:
        aspect: Width of the window, in heights.
        half_width_m: What shall be seen at least to the left and right [m].
    """
    half = math.tan(_FOV_RAD / 2.0)
    away = max(_HALF_HEIGHT_M, half_width_m / max(aspect, 0.2)) / half
    eye: FloatArray = _TARGET_M + away * _FROM
    return eye


def _ring(x: float, y: float, radius_m: float, every: int) -> FloatArray:
    """Return a circle on the table as lines, (N, 2, 3); every so manieth is drawn."""
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS + 1)
    points = np.stack(
        [
            x + radius_m * np.cos(angles),
            y + radius_m * np.sin(angles),
            np.full_like(angles, _OVER_TABLE_M),
        ],
        1,
    )
    return np.stack([points[:-1], points[1:]], 1)[::every]
