"""Support relations, read off contacts, speeds and tilts of a scene.

Everything here is a function of where things are and how fast they move, not of what
the engine computed last: it is the same after a step, after a snapshot was restored,
and after something was put elsewhere by hand.
"""

import math
from collections.abc import Iterator

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.poses import Pose
from lemma.core.seeding import ordered_sum
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import Point
from lemma.scene.scene import Scene

REST_M_S = 0.01
"""An object at rest is slower than this [m/s]. After a second of rest it moves at less
than a billionth of it."""
REST_RAD_S = 0.1
"""And it turns slower than this [rad/s]."""
TILT_RAD = math.radians(3.0)
"""An object stands on a face that is within this of level [rad]."""
_STEEP = math.cos(math.radians(30.0))
"""A contact carries if its normal is nearer to the vertical than this."""


def is_at_rest(scene: Scene, name: str) -> bool:
    """Whether an object neither moves nor turns."""
    return scene.speed(name) < REST_M_S and scene.turn_rate(name) < REST_RAD_S


def stands_on_a_face(scene: Scene, name: str) -> bool:
    """Whether one of the faces that an object may stand on is level, below it."""
    up, least = _upward(scene.pose(name)), math.cos(TILT_RAD)
    return any(
        ordered_sum(a * b for a, b in zip(up, top, strict=True)) >= least
        for top in kind_of(name).tops
    )


def carries_alone(scene: Scene, bottom: str, top: str) -> bool:
    """Whether an object lies on another one, and nothing else touches it from anywhere.

    Objects on the upper one may touch it from above. No robot may touch
    either of them; a bottom that is fixed to the table may be touched.

    Args:
        scene: Where things are now.
        bottom: Name of the object below.
        top: Name of the movable object above.
    """
    model = scene.model
    lower, upper = (int(model.body(name).id) for name in (bottom, top))
    carried = False
    for first, second, rise in _touching(scene, (upper, lower)):
        entity = scene.entity_of_body(second)
        if first == lower:
            if entity is None and second > 0 and bottom in scene.movable_names:
                return False
        elif second == lower:
            carried = carried or rise <= -_STEEP
        elif entity is None or rise < _STEEP:
            return False
    return carried


def _touching(
    scene: Scene, bodies: tuple[int, ...]
) -> Iterator[tuple[int, int, float]]:
    """Yield who touches some bodies, and how far up from them that is.

    Yields:
        One of the bodies; the body that touches it, 0 for the room; and the vertical
        component of the contact's normal, from the first to the second.
    """
    data = scene.posed(scene.data.qpos)
    mujoco.mj_collision(scene.model, data)
    contact = data.contact
    owners = scene.model.body_rootid[scene.model.geom_bodyid[contact.geom]]
    rises = np.asarray(contact.frame)[:, 2]
    for (one, other), rise in zip(owners.tolist(), rises.tolist(), strict=True):
        if one in bodies:
            yield one, other, rise
        if other in bodies:
            yield other, one, -rise


def _upward(pose: Pose) -> Point:
    """Return where the vertical points in the frame of a pose."""
    w, x, y, z = pose.quaternion
    return (
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
