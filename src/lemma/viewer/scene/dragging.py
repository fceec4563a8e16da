"""Dragging and turning of robots and objects with the mouse."""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.bodies import resting_quaternion
from lemma.scene.scene import Scene
from lemma.viewer.scene.bodies import Bodies

HANDLES = "/dragging"
"""Name of the node with the handles for turning."""
_HANDLES_SCALE = 0.22
_ROBOT_SCALE = 0.45
_LEAST_SLOPE = 0.05


class Dragging:
    """Robots and objects that may be dragged, and their shown poses."""

    def __init__(
        self, server: viser.ViserServer, drop: Callable[[str, Pose2], None]
    ) -> None:
        """Begin without a scene.

        Args:
            server: The page's server.
            drop: Called in its own thread with the name and new pose of an object.
        """
        self._server, self._drop = server, drop
        self._bodies: Bodies | None = None
        self._bases: dict[str, Pose2] = {}
        self._bound: set[str] = set()
        self._handles: Any = None
        self._selected = ""
        self._offset, self._height_m = np.zeros(2), 0.0

    def watch(self, bodies: Bodies, scene: Scene) -> None:
        """Set the scene.

        Args:
            bodies: The bodies' nodes, new ones or those of the previous scene.
            scene: The scene of the bodies.
        """
        spec = scene.spec
        if bodies is not self._bodies:
            self._bodies, self._bound = bodies, set()
            self._handles, self._selected = None, ""
        bases = (robot.base for robot in spec.robots)
        self._bases = dict(zip(spec.robot_names, bases, strict=True))
        self._place_handles()

    def allow(self, names: set[str]) -> None:
        """Set the names of the robots and objects that may be dragged."""
        if self._bodies is None:
            return
        for name in self._bound - names:
            for part in self._bodies.parts.get(name, ()):
                part.remove_drag_callback("all")
                part.remove_click_callback("all")
        for name in names - self._bound:
            for part in self._bodies.parts.get(name, ()):
                part.on_drag(self._dragging(name))
                part.on_click(self._clicking(name))
        self._bound = set(names)
        if self._selected not in names:
            self._select("")

    def let_go(self) -> None:
        """Show all robots and objects at their real poses."""
        if self._bodies is not None:
            self._bodies.elsewhere.clear()
            self._place_handles()

    def _home(self, name: str) -> Pose2:
        """Return the real pose of a robot or object, without its shown offset."""
        assert self._bodies is not None
        return self._bases.get(name) or self._bodies.pose(name)

    def _now(self, name: str) -> Pose2:
        assert self._bodies is not None
        by, home = self._bodies.elsewhere.get(name), self._home(name)
        return home if by is None else by @ home

    def _carry(self, name: str, pose: Pose2) -> None:
        if self._bodies is not None:
            self._bodies.elsewhere[name] = pose @ self._home(name).inverse()

    def _clicking(self, name: str) -> Callable[[Any], Any]:
        async def clicked(_: Any) -> None:
            self._select(name)

        return clicked

    def _dragging(self, name: str) -> Callable[[Any], Any]:
        # viser awaits coroutines in order, but runs functions in threads.
        async def dragged(event: Any) -> None:
            now, eye = self._now(name), np.asarray(event.client.camera.position, float)
            if event.phase == "start":
                self._select(name)
                self._height_m = float(event.start_position[2])
                at = _on_plane(eye, np.asarray(event.start_position), self._height_m)
                self._offset = np.array(now.xy) - (at if at is not None else now.xy)
            at = _on_plane(eye, np.asarray(event.end_position), self._height_m)
            if at is not None:
                x, y = at + self._offset
                self._carry(name, Pose2(float(x), float(y), now.yaw))
            self._place_handles()
            if event.phase == "end":
                self._put_down(name)

        return dragged

    def _select(self, name: str) -> None:
        self._selected = name
        self._place_handles()

    def _place_handles(self) -> None:
        """Put the handles around the selected robot or object, if any."""
        if not self._selected or self._bodies is None:
            if self._handles is not None:
                self._handles.visible = False
            return
        if self._handles is None:
            # Active axes x and y include rotation about z.
            self._handles = self._server.scene.add_transform_controls(
                HANDLES, active_axes=(True, True, False), depth_test=False, opacity=0.7
            )
            self._handles.on_update(self._turned)
        pose = self._now(self._selected)
        with self._server.atomic():
            is_robot = self._selected in self._bases
            self._handles.scale = _ROBOT_SCALE if is_robot else _HANDLES_SCALE
            self._handles.position = (pose.x, pose.y, 0.02)
            self._handles.wxyz = resting_quaternion(pose.yaw)
            self._handles.visible = True

    async def _turned(self, event: Any) -> None:
        if self._selected:
            x, y, _ = (float(value) for value in event.target.position)
            w, _, _, z = (float(value) for value in event.target.wxyz)
            self._carry(self._selected, Pose2(x, y, 2.0 * math.atan2(z, w)))
            if event.phase == "end":
                self._put_down(self._selected)

    def _put_down(self, name: str) -> None:
        # It may wait for a policy, so run it outside of the server's event loop.
        pose, loop = self._now(name), asyncio.get_running_loop()
        loop.run_in_executor(None, self._drop, name, pose)


def _on_plane(eye: FloatArray, point: FloatArray, height_m: float) -> FloatArray | None:
    """Return the intersection of a line of sight with a horizontal plane.

    Args:
        eye: Position of the camera, (3,) [m].
        point: Another point on the line of sight, (3,) [m].
        height_m: Height of the plane [m].

    Returns:
        Position (x, y), (2,) [m]; None if line and plane are nearly parallel.
    """
    along = point - eye
    along = along / (np.linalg.norm(along) + 1e-12)
    if along[2] > -_LEAST_SLOPE:
        return None
    found: FloatArray = (eye + (height_m - eye[2]) / along[2] * along)[:2]
    return found
