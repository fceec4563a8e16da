"""Meshes for the bodies of a scene: one per body and color."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.bodies import resting_quaternion
from lemma.scene.objects.entity import entity_named
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.instance import Instance
from lemma.viz.recording import robot_titles

WORLD = "/world"
"""Parent node of the bodies' nodes, if there is one table."""
_MOVED_M = 1e-5
_VISIBLE_GROUPS = 3
"""Geoms of this group and above are for collisions."""
_PLANE_M = 15.0
"""Half the side of the square that represents an infinite plane [m]."""
_SMOOTH_RAD = 0.7
"""Faces that meet at a smaller angle are shaded smoothly [rad]."""
_SECTIONS = 48


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
    # The light shines from its position towards the origin.
    scene.add_light_directional(
        "/light/sun", intensity=1.25, cast_shadow=True, position=(-1.2, -1.6, 3.2)
    )
    scene.add_light_directional("/light/fill", intensity=0.3, position=(2.5, 1.0, 2.0))


def name_bodies(
    server: viser.ViserServer, instance: Instance, root: str = WORLD
) -> list[Any]:
    """Label robots and objects with their names in sentences.

    Args:
        server: The page's server.
        instance: The instance of the scene.
        root: Parent node of the bodies' nodes.

    Returns:
        The labels' nodes.
    """
    titles = robot_titles(instance).items()
    labels = [(f"{name}/base", title, -0.12) for name, title in titles]
    things = instance.scene.object_names
    labels += [(name, entity_named(name).phrase, 0.06) for name in things]
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
    """Nodes of the bodies of one scene; only poses that change are sent."""

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        root: str = WORLD,
        at_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        bounded: bool = False,
    ) -> None:
        """Draw the bodies.

        Args:
            server: The page's server.
            scene: The scene; its model is drawn, its data are neither read nor changed.
            root: Parent node of the bodies' nodes.
            at_m: The scene's origin in the page's frame, (3,) [m].
            bounded: Whether to leave out infinite planes, if another table has them.
        """
        self._server, self._model = server, scene.model
        self.data = mujoco.MjData(scene.model)
        """The shown state; the bodies' poses are valid after :meth:`show`."""
        self.nodes: dict[int, Any] = {}
        """Nodes by MuJoCo's index of the body."""
        self.parts: dict[str, list[Any]] = {}
        """Meshes by name of the robot or object."""
        self.elsewhere: dict[str, Pose2] = {}
        """Offsets of robots and objects that are shown away from their poses."""
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
        """Return the pose of an object on the table; the yaw is that of its x axis."""
        body = self._model.body(name).id
        (x, y, _), (w, i, j, k) = self.data.xpos[body], self.data.xquat[body]
        yaw = math.atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
        return Pose2(float(x), float(y), yaw)

    def take(self, scene: Scene) -> bool:
        """Show another scene from now on, if its meshes are the same.

        Args:
            scene: The scene; its model is read, its data are neither read nor changed.

        Returns:
            Whether all robots and objects have the same kinds and colors.
        """
        if _look(scene.spec) != _look(self._spec):
            return False
        self._spec, self._model = scene.spec, scene.model
        self.data = mujoco.MjData(scene.model)
        self.elsewhere.clear()
        return True

    def show(self, qpos: FloatArray) -> None:
        """Show a state; only changed poses are sent.

        Args:
            qpos: MuJoCo's joint positions, (nq,).
        """
        data = self.data
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


def _look(spec: SceneSpec) -> tuple[object, ...]:
    """Return the properties of a scene that determine its meshes."""
    robots = tuple((robot.arm, robot.color, robot.hand) for robot in spec.robots)
    objects = tuple((o.kind, o.color, o.mass_kg is None) for o in spec.objects)
    return robots, objects, spec.gap_m


def _put(by: Pose2, pose: FloatArray) -> FloatArray:
    """Return a pose moved over the table.

    Args:
        by: The motion in the plane.
        pose: Position [m] and quaternion wxyz, (7,).

    Returns:
        Position [m] and quaternion wxyz, (7,).
    """
    found = np.empty(7)
    at = by @ Pose2(float(pose[0]), float(pose[1]))
    found[:3] = at.x, at.y, pose[2]
    turn = np.array(resting_quaternion(by.yaw))
    mujoco.mju_mulQuat(found[3:], turn, pose[3:])
    return found


@dataclass(frozen=True, slots=True)
class Shape:
    """A mesh in the frame of its body."""

    body: int
    rgb: tuple[int, int, int]
    vertices: FloatArray
    """Positions in the body's frame, (V, 3) [m]."""
    faces: NDArray[np.int64]
    """Indices of vertices, (F, 3), counterclockwise seen from outside."""
    endless: bool
    """Whether it represents an infinite plane, which casts no shadow."""


def shapes_of(model: mujoco.MjModel) -> Iterator[Shape]:
    """Yield the visible meshes of every body."""
    for body in range(model.nbody):
        alike: dict[tuple[int, int, int, bool], list[trimesh.Trimesh]] = {}
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            if model.geom_group[geom] < _VISIBLE_GROUPS:
                red, green, blue = (round(255 * c) for c in model.geom_rgba[geom][:3])
                endless = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
                key = red, green, blue, bool(endless)
                alike.setdefault(key, []).append(_mesh(model, geom))
        for (red, green, blue, endless), meshes in alike.items():
            vertices = [np.asarray(mesh.vertices) for mesh in meshes]
            firsts = np.cumsum([0, *map(len, vertices)])
            faces = [mesh.faces + firsts[i] for i, mesh in enumerate(meshes)]
            rgb = red, green, blue
            yield Shape(
                body, rgb, np.concatenate(vertices), np.concatenate(faces), endless
            )


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return a geom in the frame of its body."""
    kind, size, kinds = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = _own_mesh(model, int(model.geom_dataid[geom]))
    elif kind == kinds.mjGEOM_BOX:
        mesh = trimesh.creation.box(2.0 * size)
    elif kind == kinds.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=_SECTIONS)
    elif kind == kinds.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2.0 * size[1], size[0])
    elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        radii = size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0])
        mesh = trimesh.creation.icosphere(3).apply_scale(radii)
    else:
        side = [2.0 * (s if s > 0.0 else _PLANE_M) for s in size[:2]]
        mesh = trimesh.creation.box((*side, 0.002))
        mesh.apply_translation((0.0, 0.0, -0.001))
    placed, turned = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    placed[:3, :3], placed[:3, 3] = turned.reshape(3, 3), model.geom_pos[geom]
    return _smooth(mesh).apply_transform(placed)


def _own_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    return trimesh.Trimesh(
        model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])].astype(float),
        model.mesh_face[face : face + int(model.mesh_facenum[mesh])].copy(),
        process=False,
    )


def _smooth(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Split the vertices of a mesh at its edges, so that edges look sharp.

    Normals belong to vertices, so faces on both sides of an edge must not share them.
    """
    if not len(mesh.face_adjacency):
        return mesh
    flat = mesh.face_adjacency[mesh.face_adjacency_angles < _SMOOTH_RAD]
    joined = np.ones(len(flat)), (flat[:, 0], flat[:, 1])
    graph = coo_array(joined, (len(mesh.faces),) * 2)
    _, parts = connected_components(graph, directed=False)
    corners = np.stack([np.repeat(parts, 3), mesh.faces.ravel()], 1)
    own, index = np.unique(corners, axis=0, return_inverse=True)
    return trimesh.Trimesh(
        mesh.vertices[own[:, 1]], index.reshape(-1, 3), process=False
    )
