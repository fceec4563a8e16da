"""Grippers near objects, and contacts between parts of robots and objects."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.scene.objects.entity import kind_of

LEFT, RIGHT = 2, 4
"""Bits of the finger pads; all other parts of a robot have the bit 1."""

WATCH_M = 0.2
"""Distance from the tool centre point within which an object is near a gripper [m]."""
_STILL_M = 0.0005


def parts_of_robots(model: mujoco.MjModel, robots: list[str]) -> NDArray[np.int64]:
    """Return the robot's index and the part's bit of each geom, (ngeom, 2).

    Both are -1 for geoms that belong to no robot.

    Args:
        model: The scene's model.
        robots: Names of the robots.
    """
    found = np.full((model.ngeom, 2), -1, np.int64)
    for geom in range(len(found)):
        body = model.body(int(model.geom_bodyid[geom])).name
        robot, _, _ = body.partition("/")
        if robot in robots:
            part = model.geom(geom).name.rpartition("/")[2]
            bit = {"pad_left": LEFT, "pad_right": RIGHT}.get(part, 1)
            found[geom] = robots.index(robot), bit
    return found


def watched_m(names: Sequence[str]) -> FloatArray:
    """Return how near to the middle of each object a hand is watched, (n,) [m]."""
    return np.array([WATCH_M + handle_m(name) for name in names])


def handle_m(name: str) -> float:
    """Return how far hands are from the middle of what two robots hold [m].

    It is 0 for everything else.
    """
    handles = kind_of(name).handles
    return 0.0 if handles is None else abs(handles[0].at.x)


@kernel
def is_near_or_moved(
    qpos: FloatArray,
    at: NDArray[np.int64],
    sites: FloatArray,
    hands: NDArray[np.int64],
    seen: FloatArray,
    watch_m: FloatArray,
) -> tuple[bool, bool]:
    """Return whether a gripper is near an object, and whether an object has moved.

    Args:
        qpos: MuJoCo's ``qpos``.
        at: Address of each object's position in ``qpos``, (objects,).
        sites: World positions of all sites, (nsite, 3) [m].
        hands: Site of each gripper's tool centre point, (robots,).
        seen: Positions at the last call, (objects, 3) [m]; updated.
        watch_m: Distance within which a gripper is near, (objects,) [m].
    """
    near, moved = False, False
    for k in range(len(at)):
        x, y, z = qpos[at[k]], qpos[at[k] + 1], qpos[at[k] + 2]
        dx, dy, dz = x - seen[k, 0], y - seen[k, 1], z - seen[k, 2]
        if dx * dx + dy * dy + dz * dz > _STILL_M * _STILL_M:
            moved = True
            seen[k, 0], seen[k, 1], seen[k, 2] = x, y, z
        for hand in hands:
            dx, dy, dz = x - sites[hand, 0], y - sites[hand, 1], z - sites[hand, 2]
            if dx * dx + dy * dy + dz * dz < watch_m[k] * watch_m[k]:
                near = True
    return near, moved


class ForbiddenContacts:
    """Robots and objects that must not touch each other; none at first.

    :func:`lemma.scene.coasting.step` looks for their contacts.
    """

    def __init__(self, owner: NDArray[np.int64], robot: NDArray[np.int64]) -> None:
        """Number the objects, then the robots, then the room.

        Args:
            owner: Object of each geom, (ngeom,); negative for others.
            robot: Robot of each geom, (ngeom,); negative for others.
        """
        objects = int(owner.max(initial=-1)) + 1
        room = objects + int(robot.max(initial=-1)) + 1
        who = np.where(owner >= 0, owner, np.where(robot >= 0, objects + robot, room))
        self.who: NDArray[np.int64] = who.astype(np.int64)
        """Number of each geom, (ngeom,)."""
        self.bad = np.zeros((room + 1, room + 1), np.bool_)
        """Which numbers must not touch each other, symmetric; set it in place."""
        self.first = np.full(2, -1, np.int64)
        """Numbers of the two that touched first; -1 if none have."""


@kernel
def note_bad(
    contacts: NDArray[np.int32],
    who: NDArray[np.int64],
    bad: NDArray[np.bool_],
    first: NDArray[np.int64],
) -> None:
    """Note the first contact of two that must not touch, unless one is noted already.

    Args:
        contacts: Both geoms of each contact, (ncon, 2).
        who: See :class:`ForbiddenContacts`.
        bad: The same.
        first: The same; written.
    """
    for c in range(len(contacts)):
        a, b = who[contacts[c, 0]], who[contacts[c, 1]]
        if bad[a, b] and first[0] < 0:
            first[0], first[1] = a, b


@kernel
def find_touches(
    contacts: NDArray[np.int32],
    owner: NDArray[np.int64],
    parts: NDArray[np.int64],
    touch: NDArray[np.int64],
) -> None:
    """Set the bits of the robots' parts that touch objects.

    Args:
        contacts: Both geoms of each contact, (ncon, 2).
        owner: Object of each geom, (ngeom,); negative for others.
        parts: Result of :func:`parts_of_robots`, (ngeom, 2).
        touch: Bits of the touching parts, (robots, objects); written.
    """
    for c in range(len(contacts)):
        for side in range(2):
            a, b = contacts[c, side], contacts[c, 1 - side]
            if owner[a] >= 0 and parts[b, 0] >= 0:
                touch[parts[b, 0], owner[a]] |= parts[b, 1]
