"""Nodes that look like the bodies of a scene, wherever its table stands in the page."""

import math
from typing import Any

import numpy as np
import viser

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.instance import Instance
from lemma.viewer.scene.shapes import shapes_of
from lemma.viz.recording import robot_titles

WORLD = "/world"
"""Name above those of the bodies, where there is one table."""
_MOVED_M = 1e-5


def light_room(server: viser.ViserServer) -> None:
    """Light a page from above, with shadows."""
    scene = server.scene
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
    scene.add_light_directional("/light/fill", intensity=0.3, position=(2.5, 1.0, 2.0))


def name_bodies(
    server: viser.ViserServer, instance: Instance, root: str = WORLD
) -> list[Any]:
    """Write names beside robots and objects, as sentences call them.

    Args:
        server: The page.
        instance: Of the scene whose bodies are there.
        root: Name above those of the bodies.
    """
    titles = zip(instance.scene.robot_names, robot_titles(instance), strict=True)
    labels = [(f"{name}/base", title, -0.12) for name, title in titles]
    for name in instance.scene.object_names:
        labels.append((name, entity_named(name).phrase, 0.06))
    return [
        server.scene.add_label(
            f"{root}/{body}/name",
            text,
            position=(0.0, 0.0, height_m),
            anchor="bottom-center",
            font_screen_scale=0.75,
        )
        for body, text, height_m in labels
    ]


class Bodies:
    """Bodies of one scene; those that move are sent again when they have moved."""

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        root: str = WORLD,
        at_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        bounded: bool = False,
    ) -> None:
        """Draw them.

        Args:
            server: The page.
            scene: Its model is drawn, its data are left alone.
            root: Name above those of the bodies.
            at_m: Where the scene's origin is in the page, (3,) [m].
            bounded: Leave out endless planes, which another table has drawn.
        """
        self._server, self._model = server, scene.model
        self.data = mujoco.MjData(scene.model)
        """The shown state; poses of bodies are up to date after :meth:`show`."""
        self.nodes: dict[int, Any] = {}
        """Nodes by number of the body."""
        self.parts: dict[str, list[Any]] = {}
        """Meshes by name of their robot or object."""
        self.elsewhere: dict[str, Pose2] = {}
        """Offsets of robots and objects that are shown beside their poses."""
        self._spec = scene.spec
        self._shown: dict[int, FloatArray] = {}
        server.scene.add_frame(root, show_axes=False, position=at_m)
        for number, shape in enumerate(shapes_of(scene.model)):
            if shape.endless and bounded:
                continue
            name = f"{root}/{scene.model.body(shape.body).name}"
            if shape.body not in self.nodes:
                self.nodes[shape.body] = server.scene.add_frame(name, show_axes=False)
            mesh = server.scene.add_mesh_simple(
                f"{name}/part_{number}",
                shape.vertices,
                shape.faces,
                color=shape.rgb,
                cast_shadow=not shape.endless,
                receive_shadow=0.35,
            )
            self.parts.setdefault(self._owner(shape.body), []).append(mesh)

    def _owner(self, body: int) -> str:
        name: str = self._model.body(body).name
        return name.partition("/")[0]

    def pose(self, name: str) -> Pose2:
        """Return where an object is on the table, as its x axis points."""
        body = self._model.body(name).id
        (x, y, _), (w, i, j, k) = self.data.xpos[body], self.data.xquat[body]
        yaw = math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
        return Pose2(float(x), float(y), yaw)

    def take(self, scene: Scene) -> bool:
        """Show another scene from now on, if it looks the same.

        Args:
            scene: Its model is read, its data are left alone.

        Returns:
            Whether it does: nothing has another kind or color.
        """
        if _look(scene.spec) != _look(self._spec):
            return False
        self._spec, self._model = scene.spec, scene.model
        self.data = mujoco.MjData(scene.model)
        self.elsewhere.clear()
        return True

    def show(self, qpos: FloatArray) -> int:
        """Put all bodies where they are, and send those that moved.

        Args:
            qpos: Positions of all joints, (nq,).

        Returns:
            How many bodies were moved.
        """
        data, moved = self.data, 0
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        for body, handle in self.nodes.items():
            pose = np.concatenate([data.xpos[body], data.xquat[body]])
            by = self.elsewhere.get(self._owner(body))
            if by is not None:
                pose = _put(by, pose)
            shown = self._shown.get(body)
            if shown is None or np.abs(shown - pose).max() > _MOVED_M:
                handle.position, handle.wxyz = pose[:3], pose[3:]
                self._shown[body] = pose
                moved += 1
        return moved


def _look(spec: SceneSpec) -> tuple[object, ...]:
    """Return what meshes depend on."""
    robots = tuple((robot.arm, robot.color) for robot in spec.robots)
    return robots, tuple((o.kind, o.color) for o in spec.objects), spec.gap_m


def _put(by: Pose2, pose: FloatArray) -> FloatArray:
    """Return a pose moved over the table, position and quaternion wxyz, (7,)."""
    found = np.empty(7)
    at = by @ Pose2(float(pose[0]), float(pose[1]))
    found[:3] = at.x, at.y, pose[2]
    half = by.yaw / 2.0
    turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    mujoco.mju_mulQuat(found[3:], turn, pose[3:])
    return found
