"""Events: detect whether the stages may have changed since they were computed.

Computing stages takes as long as several physics steps, and they are constant while a
hand approaches a cube or carries it over the table. So one kernel computes *flags*:
contacts between robot parts and objects, hands near objects, and objects that are led,
at rest, fallen, moved or lifted. Stages are recomputed if

- a flag has changed;
- an object moved that no robot leads, that is slow enough to count as at rest, or that
  a hand is near or touches without holding: the robots that reach it may have changed;
- an object moved that is the place of another object near or in a hand, or for which
  the resting stick may be in position;
- one object stands on another as the plan or goal requires, or they refer to a hand,
  and a hand or a moved object is near: the engine has not computed yet whether they
  touch now.

Otherwise every predicate of :mod:`lemma.env.stages` is unchanged, except for an object
within :data:`STILL_M` of a limit, and for an elbow that touches a standing object
between two physics steps. The decision depends only on the observed states, and its
data are saved with the stages.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.scene.coasting import note_leads
from lemma.scene.objects.contacts import (
    LEFT,
    RIGHT,
    WATCH_M,
    find_touches,
    handle_m,
)
from lemma.scene.objects.entity import HAND, STICK, kind_of
from lemma.scene.objects.stick import GRASP_FROM_END_M
from lemma.scene.scene import Scene
from lemma.tasks.goal import REST_M_S, REST_RAD_S, Goal
from lemma.tasks.subtask import Primitive, SubTask

NEAR_M = 0.10
"""A hand is near an object if its tool centre point is within this of the grasp [m]."""
LIFT_M = 0.015
"""An object is lifted if it is this much higher than initially [m]."""
MOVED_M = 0.03
"""An object has moved if it is this far from its initial position [m]."""
STILL_M = 0.0001
"""An object has not moved if it is within this distance of its last position [m]."""

_STILL_TURN = 0.0005
_NEAR = 8
"""Flag bit for a near hand, above the bits of a robot's parts that touch an object."""
_LED, _RESTS, _FALLEN, _MOVED, _LIFTED = 1, 2, 4, 8, 16
_HANDS = (Primitive.REACH, Primitive.LIFT)


@dataclass(frozen=True, slots=True)
class EventState:
    """State from which stages were last computed; plain data."""

    poses: tuple[float, ...]
    flags: tuple[int, ...]


class StageEvents:
    """Compares the present state with the one from which stages were last computed."""

    def __init__(
        self, scene: Scene, goal: Goal, plan: tuple[SubTask, ...], first: FloatArray
    ) -> None:
        """Prepare; stages have not been computed yet.

        Args:
            scene: The scene.
            goal: The goal of the episode.
            plan: The expert's plan for it.
            first: Initial positions of objects, (objects, 3) [m].
        """
        self._data, coasting = scene.data, scene.coasting
        names = coasting.names
        robots, count = len(scene.robots), len(names)
        number = {name: k for k, name in enumerate(names)}
        self._poses = np.full((count, 7), np.nan)
        self._flags = np.full((robots + 1, count), -1, np.int64)
        self._now, self._stirs = self._flags.copy(), np.zeros(count, np.bool_)
        self._contacts = (coasting.owner, scene.parts)
        self._motion = (self._data.qpos, self._data.qvel, self._data.site_xpos)
        self._at, self._hands = coasting.qpos_at, scene.tcp_sites
        sizes = [_size(scene, k) for k in range(count)]
        self._sizes = np.array(sizes).reshape(-1, 3)
        self._objects = (
            *(self._at, coasting.qvel_at, coasting.mass_at, self._hands, self._sizes),
            *(first, np.array([REST_M_S, REST_RAD_S])),
        )
        pairs = dict.fromkeys(goal.pairs)
        for step in plan:
            if step.primitive in _HANDS:
                pairs[HAND, step.pick] = None
            elif step.pick != STICK and step.place in scene.object_names:
                pairs[step.pick, step.place] = None
        stands = [[number.get(name, -1) for name in pair] for pair in pairs]
        self._stands = np.array(stands, np.int64).reshape(-1, 2)
        supports = [_support(top, bottom, scene) for top, bottom in pairs]
        self._supports = np.array(supports).reshape(-1, 4)
        # A sub-task that picks the stick may find it in position for a cube at the
        # place.
        steps = [
            (number[step.pick], number[step.place], step.pick == STICK)
            for step in plan
            if {step.pick, step.place} <= {*names}
        ]
        self._steps = np.array(steps, np.int64).reshape(-1, 3)

    def state(self) -> EventState:
        """Return the state from which stages were last computed."""
        poses, flags = self._poses.ravel().tolist(), self._flags.ravel().tolist()
        return EventState(tuple(poses), tuple(flags))

    def restore(self, state: EventState) -> None:
        """Restore an earlier state."""
        self._poses[:] = np.reshape(state.poses, self._poses.shape)
        self._flags[:] = np.reshape(state.flags, self._flags.shape)

    def look(self) -> bool:
        """Return whether stages must be computed from the present state."""
        qpos, _, sites = self._motion
        now, stirs = self._now, self._stirs
        seen: tuple[Any, ...] = (*self._contacts, *self._motion, *self._objects)
        seen = (self._data.contact.geom, *seen, self._poses, now, stirs)
        _note(*seen)
        wanted: tuple[Any, ...] = (self._steps, self._stands, self._supports)
        around: tuple[Any, ...] = (qpos, self._at, sites, self._hands, self._sizes)
        if not _must_tell(now, self._flags, stirs, *wanted, *around):
            return False
        self._flags[:] = now
        for k, at in enumerate(self._at):
            self._poses[k] = qpos[at : at + 7]
        return True


def _size(scene: Scene, item: int) -> tuple[float, float, float]:
    """Return an object's grasp position along x, its extent and its handles [m].

    Handles are to both sides of the middle, of what two robots carry; 0 if there are
    none.
    """
    coasting, model = scene.coasting, scene.model
    mine = coasting.owner == item
    # The distance of a corner is at most twice the largest coordinate.
    extent = model.geom_rbound[mine] + 2.0 * np.abs(model.geom_pos[mine]).max(axis=1)
    name = coasting.names[item]
    handle, along = handle_m(name), GRASP_FROM_END_M if name == STICK else 0.0
    return along + handle, float(extent.max()), handle


def _support(top: str, bottom: str, scene: Scene) -> tuple[float, float, float, float]:
    """Return the tolerance of the top's position on a bottom, and its center [m]."""
    if bottom not in scene.object_names:
        return (0.0, 0.0, 0.0, 0.0)
    x, y, z = scene.position(bottom)
    # A plank's middle is half of its span away.
    beside_m = 0.0 if top == HAND else 0.5 * (kind_of(top).span_m or 0.0)
    return (beside_m + (kind_of(bottom).support_m or 0.0), x, y, z)


@kernel
def _note(  # noqa: PLR0913
    contacts: NDArray[np.int32],
    owner: NDArray[np.int64],
    parts: NDArray[np.int64],
    qpos: FloatArray,
    qvel: FloatArray,
    sites: FloatArray,
    at: NDArray[np.int64],
    velocity_at: NDArray[np.int64],
    mass_at: FloatArray,
    hands: NDArray[np.int64],
    sizes: FloatArray,
    first: FloatArray,
    rest: FloatArray,
    poses: FloatArray,
    now: NDArray[np.int64],
    stirs: NDArray[np.bool_],
) -> None:
    """Write the flags of the present state, and mark the objects that moved."""
    count, robots = len(at), len(hands)
    led, carried = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    now[:] = 0
    find_touches(contacts, owner, parts, now)
    note_leads(contacts, owner, led, carried)
    for k in range(count):
        q = qpos[at[k] : at[k] + 7]
        v = qvel[velocity_at[k] : velocity_at[k] + 6]
        now[robots, k] = _flags_of(q, v, mass_at[k], first[k], rest)
        if led[k]:
            now[robots, k] |= _LED
        stirs[k] = _is_elsewhere(q, poses[k])
        for r in range(robots):
            hand, handle = sites[hands[r]], sizes[k, 2]
            near = _from_grasp(hand, q, sizes[k, 0]) < NEAR_M
            if not near and handle > 0.0:
                near = _from_grasp(hand, q, -handle) < NEAR_M
            if near:
                now[r, k] |= _NEAR


@kernel
def _flags_of(
    q: FloatArray,
    v: FloatArray,
    mass_at: FloatArray,
    first: FloatArray,
    rest: FloatArray,
) -> int:
    """Return the flags of an object that depend on its own state alone."""
    found = 0
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    turn = math.sqrt(v[3] * v[3] + v[4] * v[4] + v[5] * v[5])
    if speed < rest[0] and turn < rest[1]:
        found |= _RESTS
    w, x, y, z = q[3], q[4], q[5], q[6]
    height = q[2] + 2.0 * (x * z - w * y) * mass_at[0]
    height += 2.0 * (y * z + w * x) * mass_at[1]
    height += (1.0 - 2.0 * (x * x + y * y)) * mass_at[2]
    if height < 0.0:
        found |= _FALLEN
    dx, dy, dz = q[0] - first[0], q[1] - first[1], q[2] - first[2]
    if math.sqrt(dx * dx + dy * dy + dz * dz) > MOVED_M:
        found |= _MOVED
    if dz > LIFT_M:
        found |= _LIFTED
    return found


@kernel
def _is_elsewhere(q: FloatArray, before: FloatArray) -> bool:
    """Return True if an object moved or turned, or if its last pose is unknown."""
    dx, dy, dz = q[0] - before[0], q[1] - before[1], q[2] - before[2]
    if not dx * dx + dy * dy + dz * dz <= STILL_M * STILL_M:
        return True
    turned = False
    for i in range(3, 7):
        turned |= not abs(q[i] - before[i]) <= _STILL_TURN
    return turned


@kernel
def _from_grasp(site: FloatArray, q: FloatArray, along_m: float) -> float:
    """Return the distance of a hand from an object's grasp position [m]."""
    w, x, y, z = q[3], q[4], q[5], q[6]
    cos, sin = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)
    length = math.sqrt(cos * cos + sin * sin)
    if length > 0.0:
        cos, sin = cos / length, sin / length
    dx = site[0] - (q[0] + along_m * cos)
    dy = site[1] - (q[1] + along_m * sin)
    dz = site[2] - q[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def _must_tell(  # noqa: PLR0913
    now: NDArray[np.int64],
    flags: NDArray[np.int64],
    stirs: NDArray[np.bool_],
    steps: NDArray[np.int64],
    stands: NDArray[np.int64],
    supports: FloatArray,
    qpos: FloatArray,
    at: NDArray[np.int64],
    sites: FloatArray,
    hands: NDArray[np.int64],
    sizes: FloatArray,
) -> bool:
    """Return True if a flag changed, or a motion or proximity may change stages."""
    robots = len(hands)
    for k in range(len(stirs)):
        for r in range(robots + 1):
            if now[r, k] != flags[r, k]:
                return True
    for k in range(len(stirs)):
        if stirs[k] and not _is_carried(now, k):
            return True
    for i in range(len(steps)):
        pick, place = steps[i, 0], steps[i, 1]
        if stirs[place]:
            if steps[i, 2] and now[robots, pick] & _RESTS:
                return True
            for r in range(robots):
                if now[r, pick] and not steps[i, 2]:
                    return True
    for i in range(len(stands)):
        top, bottom = stands[i, 0], stands[i, 1]
        low = supports[i, 1:4]
        if bottom >= 0:
            low = qpos[at[bottom] : at[bottom] + 3]
        if top >= 0 and supports[i, 0] > 0.0:
            x = qpos[at[top] : at[top] + 3]
            if not _stands(now, top, bottom, x, low, supports[i, 0]):
                continue
            low = x
        elif top >= 0:
            low = qpos[at[top] : at[top] + 3]
        if _is_watched(low, top, bottom, stirs, qpos, at, sites, hands, sizes):
            return True
    return False


@kernel
def _is_carried(now: NDArray[np.int64], k: int) -> bool:
    """Return True if an object is led, and no hand is at it except a holding one."""
    robots = len(now) - 1
    if now[robots, k] & _RESTS or not now[robots, k] & _LED:
        return False
    for r in range(robots):
        if now[r, k] and not (now[r, k] & LEFT and now[r, k] & RIGHT):
            return False
    return True


@kernel
def _stands(
    now: NDArray[np.int64],
    top: int,
    bottom: int,
    high: FloatArray,
    low: FloatArray,
    most_m: float,
) -> bool:
    """Whether one thing is above another, and both rest."""
    robots = len(now) - 1
    if not now[robots, top] & _RESTS:
        return False
    if bottom >= 0 and not now[robots, bottom] & _RESTS:
        return False
    dx, dy = high[0] - low[0], high[1] - low[1]
    return bool(dx * dx + dy * dy <= most_m * most_m and high[2] > low[2])


@kernel
def _is_watched(  # noqa: PLR0913
    middle: FloatArray,
    top: int,
    bottom: int,
    stirs: NDArray[np.bool_],
    qpos: FloatArray,
    at: NDArray[np.int64],
    sites: FloatArray,
    hands: NDArray[np.int64],
    sizes: FloatArray,
) -> bool:
    """Return True if a hand, or a moved object, is near a standing object."""
    handle = max(sizes[top, 2] if top >= 0 else 0.0, 0.0)
    handle = max(sizes[bottom, 2] if bottom >= 0 else 0.0, handle)
    for hand in hands:
        if _is_within(sites[hand], middle, WATCH_M + handle):
            return True
    for k in range(len(at)):
        near = _is_within(qpos[at[k] : at[k] + 3], middle, WATCH_M + sizes[k, 1])
        if near and stirs[k] and k not in (top, bottom):
            return True
    return False


@kernel
def _is_within(a: FloatArray, b: FloatArray, limit_m: float) -> bool:
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return bool(dx * dx + dy * dy + dz * dz < limit_m * limit_m)
