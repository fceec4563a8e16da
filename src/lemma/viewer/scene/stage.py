"""The scene on the page: bodies, light, names and overlays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray
from lemma.core.robot_names import robot_number
from lemma.policies.interfaces import Insight
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies
from lemma.viewer.scene.overlays import Point, draw_path, draw_perceived, ring
from lemma.viewer.scene.viewpoint import Viewpoint
from lemma.viz.annotate import ROBOT_INK

OVERLAYS = {
    "names": "Robots and objects, as sentences call them.",
    "reach": "Where a robot surely works (solid), and could touch at most (dashed).",
    "contacts": "Where things touch.",
    "perceived": "Things as the policy saw them, their part in the goal, and reach.",
    "path": "The path of the hand in this sub-task.",
}
"""Overlays and their hints."""
_BESIDE_M = 0.6
"""Width in view beside each robot, at least [m]."""
_NEARER = 0.25
"""Share of the distance to a visitor that is a meter towards them."""
_MOST_CONTACTS = 40
_CONTACT_RGB = (255, 140, 0)


class Stage:
    """Nodes of one scene in a page, for all of its tabs."""

    def __init__(self, server: viser.ViserServer, visible: set[str]) -> None:
        """Light an empty room.

        Args:
            server: The page.
            visible: Those of :data:`OVERLAYS` that are shown.
        """
        self._server, self._visible = server, set(visible)
        self.overlays: dict[str, list[Any]] = {name: [] for name in OVERLAYS}
        """Nodes of each overlay."""
        self.bodies: Bodies | None = None
        """Nodes that move; None before the first scene."""
        self.instance: Instance | None = None
        """Instance of the scene; None before the first."""
        self._qpos: FloatArray | None = None
        self._scene: Scene | None = None
        self._contacts: Any = None
        self._explanation: tuple[Insight | None, Sequence[Point]] = (None, ())
        self.viewpoint = Viewpoint(server, 1.0)

    def set_scene(self, scene: Scene, instance: Instance) -> bool:
        """Show another scene; nodes of a table that looks the same stay.

        Args:
            scene: Its model is drawn, its data are left alone.
            instance: Of it.

        Returns:
            Whether all nodes of the page were removed, and others drawn.
        """
        self._scene, known = scene, self.instance
        self.instance = instance
        if self.bodies is not None and self.bodies.take(scene):
            if known is None or known.scene.robots != instance.scene.robots:
                self._draw_reach(instance)
            return False
        with self._server.atomic():
            self._server.scene.reset()
            light_room(self._server)
            self.bodies = Bodies(self._server, scene)
            for handles in self.overlays.values():
                handles.clear()
            self._explanation = (None, ())
            for label in name_bodies(self._server, instance):
                label.visible = "names" in self._visible
                self._keep("names", label)
            self._draw_reach(instance)
            self._draw_contacts()
        wide_m = [abs(r.base.x) + _BESIDE_M for r in instance.scene.robots]
        # Nearer things appear farther aside.
        wide_m += [
            abs(o.pose.x) / (1.0 + _NEARER * o.pose.y) for o in instance.scene.objects
        ]
        self.viewpoint.widen(max(wide_m))
        return True

    def _draw_reach(self, instance: Instance) -> None:
        """Draw each robot's reach: surely (solid), and at most (dashed)."""
        for old in self.overlays["reach"]:
            old.remove()
        self.overlays["reach"].clear()
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
                    ring(placed.base.x, placed.base.y, radius_m, every),
                    ROBOT_INK[placed.color][:3],
                    thickness=3.0 if every == 1 else 2.0,
                    thickness_units="screen",
                    visible="reach" in self._visible,
                )
                self._keep("reach", handle)

    def explain(
        self, insight: Insight | None, robot: str, waypoints: Sequence[Point]
    ) -> None:
        """Show the policy's reasons and the path of the hand, where there are any.

        Args:
            insight: Of the policy.
            robot: Name of the robot whose hand it is.
            waypoints: Points on it [m].
        """
        instance = self.instance
        if instance is None or (insight, waypoints) == self._explanation:
            return
        self._explanation = insight, waypoints
        nodes: dict[str, list[Any]] = {"perceived": [], "path": []}
        with self._server.atomic():
            for overlay in nodes:
                for old in self.overlays[overlay]:
                    old.remove()
            if insight is not None:
                nodes["perceived"] = draw_perceived(self._server, instance, insight)
            if waypoints:
                placed = instance.scene.robots[robot_number(robot)]
                ink = ROBOT_INK[placed.color]
                nodes["path"] = draw_path(
                    self._server, waypoints, (ink[0], ink[1], ink[2])
                )
            for overlay, found in nodes.items():
                self.overlays[overlay] = found
                self.set_visible(overlay, overlay in self._visible)

    def _draw_contacts(self) -> None:
        self._contacts = self._server.scene.add_point_cloud(
            "/contacts",
            np.zeros((0, 3), np.float32),
            _CONTACT_RGB,
            point_size=0.02,
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
        """Put all bodies where they are, and send those that moved.

        Args:
            qpos: Positions of all joints, (nq,).

        Returns:
            How many bodies were moved.
        """
        if self._scene is None or self.bodies is None:
            return 0
        self._qpos = qpos
        with self._server.atomic():
            moved = self.bodies.show(qpos)
            if "contacts" in self._visible:
                self._show_contacts(self._scene.model, self.bodies.data)
        return moved

    def refresh(self) -> None:
        """Show the same state again, with things that are carried by hand."""
        if self._qpos is not None:
            self.show(self._qpos)

    def _show_contacts(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        mujoco.mj_fwdPosition(model, data)
        points = data.contact.pos[: min(data.ncon, _MOST_CONTACTS)]
        self._contacts.points = np.asarray(points, np.float32).reshape(-1, 3)
