"""The looks of a compiled model: one mesh per body and color."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray

_VISIBLE_GROUPS = 3
"""Geoms of this group and above are for collisions."""
_PLANE_M = 15.0
"""Half the side of the square that stands for an endless plane [m]."""
_SMOOTH_RAD = 0.7
"""Faces that meet at a smaller angle are shaded as one [rad]."""
_SECTIONS = 48


@dataclass(frozen=True, slots=True)
class Shape:
    """A mesh in the frame of its body."""

    body: int
    rgb: tuple[int, int, int]
    vertices: FloatArray
    """(V, 3) [m]."""
    faces: NDArray[np.int64]
    """(F, 3), vertices of each counterclockwise from outside."""
    endless: bool
    """Whether it stands for an endless plane: too wide to cast a shadow."""


def shapes_of(model: mujoco.MjModel) -> Iterator[Shape]:
    """Yield the visible meshes of every body."""
    for body in range(model.nbody):
        first = int(model.body_geomadr[body])
        alike: dict[tuple[int, int, int, bool], list[trimesh.Trimesh]] = {}
        for geom in range(first, first + int(model.body_geomnum[body])):
            if model.geom_group[geom] < _VISIBLE_GROUPS:
                red, green, blue = (round(255 * c) for c in model.geom_rgba[geom][:3])
                endless = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
                key = red, green, blue, bool(endless)
                alike.setdefault(key, []).append(_mesh(model, geom))
        for (red, green, blue, endless), meshes in alike.items():
            firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
            yield Shape(
                body,
                (red, green, blue),
                np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]),
                np.concatenate(
                    [mesh.faces + at for mesh, at in zip(meshes, firsts, strict=False)]
                ),
                endless,
            )


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return a geom in the frame of its body."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = _smooth(_own_mesh(model, int(model.geom_dataid[geom])))
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
    if kind != kinds.mjGEOM_MESH:
        mesh = _smooth(mesh)
    placed = np.eye(4)
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    placed[:3, :3], placed[:3, 3] = turned.reshape(3, 3), model.geom_pos[geom]
    return mesh.apply_transform(placed)


def _own_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    return trimesh.Trimesh(
        model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])].astype(float),
        model.mesh_face[face : face + int(model.mesh_facenum[mesh])].copy(),
        process=False,
    )


def _smooth(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Part a mesh along its edges, so that they are not shaded as if they were round.

    Normals are of vertices, so faces on both sides of an edge must not share them.
    """
    if not len(mesh.face_adjacency):
        return mesh
    flat = mesh.face_adjacency[mesh.face_adjacency_angles < _SMOOTH_RAD]
    _, parts = connected_components(
        coo_array(
            (np.ones(len(flat)), (flat[:, 0], flat[:, 1])), (len(mesh.faces),) * 2
        ),
        directed=False,
    )
    corners = np.stack([np.repeat(parts, 3), mesh.faces.ravel()], 1)
    own, index = np.unique(corners, axis=0, return_inverse=True)
    return trimesh.Trimesh(
        mesh.vertices[own[:, 1]], index.reshape(-1, 3), process=False
    )
