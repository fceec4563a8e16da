"""Checks a scene for overlapping objects and objects beside the table."""

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.scene.scene import Scene
from lemma.scene.table import TABLE_HALF_Y_M, lies_on_table, tops

TOLERANCE_M = 0.005
"""Penetration that contacts resolve without visible motion."""


def check_layout(scene: Scene) -> None:
    """Check the present positions of objects and robots; the state does not change.

    Physics would throw overlapping objects apart, and objects beside the table would
    fall.

    Raises:
        InvalidConfigError: Two of them overlap, or an object's origin is not on the
            table.
    """
    for name in scene.spec.object_names:
        _check_on_table(scene, name)
    for first, second, depth_m in _overlaps(scene):
        if depth_m > TOLERANCE_M:
            raise InvalidConfigError(
                f"{first} and {second} overlap by {1000 * depth_m:.0f} mm where they "
                "begin. Place them apart."
            )


def check_place(scene: Scene, name: str) -> None:
    """Check the present position of one object; the state does not change.

    Args:
        scene: The scene, before or during an episode.
        name: Name of the object.

    Raises:
        InvalidConfigError: It overlaps with another object or a robot, or is not on the
            table.
    """
    _check_on_table(scene, name)
    for *both, depth_m in _overlaps(scene):
        if name in both and depth_m > TOLERANCE_M:
            raise InvalidConfigError(
                f"{both[0]} and {both[1]} would overlap by {1000 * depth_m:.0f} mm."
            )


def _check_on_table(scene: Scene, name: str) -> None:
    gap, (x, y, _) = scene.spec.gap_m, scene.pose(name).position
    if not lies_on_table(gap, Pose2(x, y)):
        wide = " or ".join(f"from {a:g} to {b:g}" for a, b in tops(gap))
        raise InvalidConfigError(
            f"The {name} at ({x:g}, {y:g}) m does not lie on the table. Valid: x "
            f"{wide}, y from {-TABLE_HALF_Y_M:g} to {TABLE_HALF_Y_M:g}."
        )


def _overlaps(scene: Scene) -> list[tuple[str, str, float]]:
    """Return pairs of overlapping objects or robots, with the penetration depth [m]."""
    model, data = scene.model, scene.data
    scene.refresh()
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    roots = model.body_rootid[model.geom_bodyid[solid]]
    # Geoms of the room belong to the world body.
    solid, roots = solid[roots > 0], roots[roots > 0]
    position, radius = data.geom_xpos[solid], model.geom_rbound[solid]
    near = np.abs(position[:, None] - position).max(-1) < radius[:, None] + radius
    near &= roots[:, None] < roots
    found = []
    for i, j in np.argwhere(near).tolist():
        first, second = int(solid[i]), int(solid[j])
        gap_m = mujoco.mj_geomDistance(model, data, first, second, TOLERANCE_M, None)
        if np.abs(position[i] - position[j]).max() < TOLERANCE_M:
            # MuJoCo returns 0 for concentric geoms.
            gap_m = -float(min(radius[i], radius[j]))
        names = (model.body(int(roots[k])).name.partition("/")[0] for k in (i, j))
        found.append((*names, -gap_m))
    return found
