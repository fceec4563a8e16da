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
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.scene.spec import RobotPlacement
from lemma.tasks.instance import Instance
from lemma.viewer.scene.bodies import Bodies, light_room, name_bodies
from lemma.viewer.scene.viewpoint import Viewpoint, half_height_for
from lemma.viz.annotate import ROBOT_INK

Point = tuple[float, float, float]
Paths = Sequence[tuple[str, Sequence[Point]]]

OVERLAYS = {
    "names": "Names of robots and objects in sentences.",
    "reach": "A robot's certain workspace (solid), and its largest reach (dashed).",
    "contacts": "Points of contact.",
    "perceived": "The policy's perception: objects, their roles in the goal, reach.",
    "path": "The path of each hand in its sub-task.",
}
"""Overlays and their hints."""
_BESIDE_M = 0.6
"""Least visible width beside each robot [m]."""
_NEARER = 0.25
"""Relative decrease of the distance to the camera per meter towards it [1/m]."""
_MOST_CONTACTS = 40
_CONTACT_RGB = (255, 140, 0)
_CIRCLE_POINTS = 96
_OVER_TABLE_M = 0.006
_MARK_M = 0.012
_MARK_HEIGHT_M = 0.09
_MARK_RGB = (150, 60, 200)
_ROLE_HEIGHT_M = 0.2


class Stage:
    """Nodes of one scene on a page, for all browser tabs."""

    def __init__(self, server: viser.ViserServer, visible: set[str]) -> None:
        """Light an empty room.

        Args:
            server: The page's server.
            visible: Names of the shown overlays, from :data:`OVERLAYS`.
        """
        self._server, self._visible = server, set(visible)
        self.overlays: dict[str, list[Any]] = {name: [] for name in OVERLAYS}
        """Nodes of each overlay."""
        self.bodies: Bodies | None = None
        """Nodes of the bodies; None before the first scene."""
        self.instance: Instance | None = None
        """Instance of the scene; None before the first."""
        self._qpos: FloatArray | None = None
        self._scene: Scene | None = None
        self._contacts: Any = None
        self._explanation: tuple[Insight | None, Paths] = (None, ())
        self.viewpoint = Viewpoint(server, 1.0)

    def set_scene(self, scene: Scene, instance: Instance) -> bool:
        """Show another scene; keep the nodes if its meshes are the same.

        Args:
            scene: The scene; its model is drawn, its data are neither read nor changed.
            instance: The instance of the scene.

        Returns:
            Whether all nodes of the page were replaced.
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
            self.overlays = {name: [] for name in OVERLAYS}
            self._explanation = (None, ())
            self._keep("names", name_bodies(self._server, instance))
            self._draw_reach(instance)
            self._contacts = self._server.scene.add_point_cloud(
                "/contacts",
                np.zeros((0, 3), np.float32),
                _CONTACT_RGB,
                point_size=0.02,
                point_shape="circle",
            )
            self._keep("contacts", [self._contacts])
        wide_m = [abs(r.base.x) + _BESIDE_M for r in instance.scene.robots]
        # Perspective moves near objects outwards.
        wide_m += [
            abs(o.pose.x) / (1.0 + _NEARER * o.pose.y) for o in instance.scene.objects
        ]
        self.viewpoint.widen(max(wide_m), half_height_for(instance))
        return True

    def _draw_reach(self, instance: Instance) -> None:
        """Draw each robot's certain workspace (solid) and largest reach (dashed)."""
        self._clear("reach")
        nodes, names = [], instance.scene.robot_names
        for name, placed in zip(names, instance.scene.robots, strict=True):
            reach, could = reach_of(placed.arm), could_of(placed.arm)
            nodes += [
                self._circle(f"/reach/{name}/{part}", placed, placed.base.xy, *looks)
                for part, looks in {
                    "travel": (reach.travel_m, 1, 3.0),
                    "inner": (reach.inner_m, 1, 3.0),
                    "touch": (could.touch_m, 2, 2.0),
                }.items()
            ]
        self._keep("reach", nodes)

    def _circle(
        self,
        name: str,
        placed: RobotPlacement,
        at: tuple[float, float],
        radius_m: float,
        every: int,
        thickness: float,
    ) -> Any:
        """Draw a circle on the table in a robot's color, dashed if ``every`` > 1.

        Args:
            name: Name of the node.
            placed: The robot.
            at: Middle of the circle (x, y) [m].
            radius_m: Its radius [m].
            every: Of this number of segments, one is drawn.
            thickness: Width of the line [px].
        """
        angles = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS + 1)
        x, y = at[0] + radius_m * np.cos(angles), at[1] + radius_m * np.sin(angles)
        points = np.stack([x, y, np.full_like(angles, _OVER_TABLE_M)], 1)
        return self._server.scene.add_line_segments(
            name,
            np.stack([points[:-1], points[1:]], 1)[::every],
            ROBOT_INK[placed.color],
            thickness=thickness,
            thickness_units="screen",
        )

    def explain(self, insight: Insight | None, paths: Paths) -> None:
        """Show the policy's perception and the paths of hands, if there are any.

        Args:
            insight: The policy's reasons; None for none.
            paths: Names of robots, and points on the paths of their hands [m].
        """
        instance = self.instance
        if instance is None or (insight, paths) == self._explanation:
            return
        self._explanation = insight, paths
        with self._server.atomic():
            self._clear("perceived")
            self._clear("path")
            if insight is not None:
                self._keep("perceived", self._draw_perceived(instance, insight))
            nodes = []
            for robot, waypoints in paths:
                placed = instance.scene.robots[robot_number(robot)]
                nodes += self._draw_path(robot, waypoints, ROBOT_INK[placed.color])
            self._keep("path", nodes)

    def _draw_perceived(self, instance: Instance, insight: Insight) -> list[Any]:
        """Mark each perceived object, its role in the goal, and each robot's reach."""
        nodes: list[Any] = []
        robots = zip(insight.robots, instance.scene.robots, strict=False)
        for number, (seen, placed) in enumerate(robots):
            for radius_m in seen.reach_m:
                name = f"/perceived/robot_{number}/{len(nodes)}"
                nodes.append(self._circle(name, placed, seen.at, radius_m, 3, 3.0))
        for thing in insight.objects:
            parts = [entity_named(thing.name).phrase]
            for pair in insight.goal:
                roles = zip(pair, ("goes on top", "lies below"), strict=True)
                parts += [role for name, role in roles if name == thing.name]
            name = f"/perceived/{thing.name}"
            mark = self._server.scene.add_icosphere(
                name, _MARK_M, color=_MARK_RGB, position=(*thing.at, _MARK_HEIGHT_M)
            )
            label = self._server.scene.add_label(
                f"{name}_role",
                f"sees: {', '.join(parts)}",
                position=(*thing.at, _ROLE_HEIGHT_M),
                anchor="bottom-center",
                font_screen_scale=0.7,
            )
            nodes += [mark, label]
        return nodes

    def _draw_path(
        self, robot: str, points: Sequence[Point], rgb: tuple[int, int, int]
    ) -> list[Any]:
        """Draw the path of a hand [m]."""
        at = np.asarray(points, np.float32)
        lines = self._server.scene.add_line_segments(
            f"/path/{robot}/lines",
            np.stack([at[:-1], at[1:]], 1),
            rgb,
            thickness=4.0,
            thickness_units="screen",
        )
        ends = self._server.scene.add_point_cloud(
            f"/path/{robot}/points", at[1:], rgb, point_size=0.02, point_shape="circle"
        )
        return [lines, ends]

    def _clear(self, overlay: str) -> None:
        """Remove an overlay's nodes before new ones with the same names are drawn."""
        for old in self.overlays[overlay]:
            old.remove()
        self.overlays[overlay] = []

    def _keep(self, overlay: str, nodes: list[Any]) -> None:
        self.overlays[overlay] = nodes
        self.set_visible(overlay, overlay in self._visible)

    def set_visible(self, overlay: str, visible: bool) -> None:
        """Show or hide one of :data:`OVERLAYS`."""
        (self._visible.add if visible else self._visible.discard)(overlay)
        for handle in self.overlays[overlay]:
            handle.visible = visible

    def show(self, qpos: FloatArray) -> None:
        """Show a state; only changed poses are sent.

        Args:
            qpos: MuJoCo's joint positions, (nq,).
        """
        if self._scene is None or self.bodies is None:
            return
        self._qpos = qpos
        with self._server.atomic():
            self.bodies.show(qpos)
            if "contacts" in self._visible:
                self._show_contacts(self._scene.model, self.bodies.data)

    def refresh(self) -> None:
        """Show the same state again, with the offsets of dragged objects."""
        if self._qpos is not None:
            self.show(self._qpos)

    def _show_contacts(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        mujoco.mj_fwdPosition(model, data)
        points = data.contact.pos[: min(data.ncon, _MOST_CONTACTS)]
        self._contacts.points = np.asarray(points, np.float32).reshape(-1, 3)
