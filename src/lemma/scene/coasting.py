"""Detects thrown objects: objects that move without a robot.

Reach only limits what a robot can do if objects do not move without a robot. So an
object may coast no farther than :data:`COAST_M` before it rests, and fly no longer than
:data:`FLIGHT_S`; otherwise it counts as *thrown*.

A robot *leads* an object if it touches the object directly or through a chain of
movable objects in contact: a cube in the gripper, a cube that the stick pushes, the
upper one of two carried cubes. An object *flies* if no such chain connects it to a
robot, the table or the floor.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray

COAST_M = 0.04
"""Largest horizontal distance of an object's centre of mass from its position when a
robot last led it, or when it last rested [m]."""
FLIGHT_S = 0.15
"""Longest flight [s], which corresponds to a fall of 11 cm."""

_SLOW_M_S = 0.02
_REST_TICKS = 10
"""Number of servo ticks that all objects must be slow to count as resting."""
_ROOM, _ROBOT = -1, -2


@dataclass(frozen=True, slots=True)
class CoastingState:
    """Copied state of a :class:`Coasting`."""

    left_m: FloatArray
    since_s: FloatArray
    thrown: NDArray[np.bool_]
    awake: int


class Coasting:
    """Tracks how far and how long each object of a scene moves without a robot."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Start in a state in which no robot touches an object.

        Args:
            model: The scene's model.
            data: Its data, which are read at every call.
        """
        free = [j for j in range(model.njnt) if model.jnt_type[j] == 0]
        self._data = data
        self._qpos, self._qvel = data.qpos, data.qvel
        self.qpos_at = model.jnt_qposadr[free].astype(np.int64)
        """Address of each object's position in ``qpos``, (objects,)."""
        self.qvel_at = model.jnt_dofadr[free].astype(np.int64)
        """Address of each object's velocity in ``qvel``, (objects,)."""
        self.mass_at = model.body_ipos[[int(model.jnt_bodyid[j]) for j in free]]
        self.mass_at = np.ascontiguousarray(self.mass_at.reshape(-1, 3))
        """Centre of mass of each object in its frame, (objects, 3) [m]."""
        self.owner = _owners(model, [int(model.jnt_bodyid[j]) for j in free])
        """Owner of each geom, (ngeom,): index of an object; negative for the room or a
        robot."""
        self.names = tuple(model.body(int(model.jnt_bodyid[j])).name for j in free)
        """The objects that are not fixed to the table."""
        self.left_m = np.zeros((len(free), 2))
        """World x, y of each object's centre of mass when a robot last led it or it
        last rested, (objects, 2) [m]."""
        self.since_s = np.zeros(len(free))
        """Simulated time of each object's last contact, (objects,) [s]."""
        self._thrown = np.zeros(len(free), np.bool_)
        self._fallen = np.zeros(len(free), np.bool_)
        self._held = np.zeros(len(free), np.bool_)
        self._resting = np.zeros(len(free), np.bool_)
        self._awake = 0
        # Bound once, because collecting the arguments takes as long as passing them.
        self._rest = partial(
            _rest,
            *(self._qvel, self.qvel_at, self._qpos, self.qpos_at, self.mass_at),
            *(self.left_m, self.since_s),
        )
        self.is_thrown = False
        """Whether an object has been thrown."""
        for name in self.names:
            self.put(name)

    def put(self, name: str) -> None:
        """Reset the tracking of an object that was moved to its present pose."""
        k = self.names.index(name)
        self.left_m[k] = _middle(self._qpos, self.qpos_at[k], self.mass_at[k])
        self.since_s[k] = self._data.time

    @property
    def thrown(self) -> tuple[str, ...]:
        """Names of the objects that have been thrown."""
        if not self.is_thrown:
            return ()
        pairs = zip(self.names, self._thrown.tolist(), strict=True)
        return tuple(name for name, thrown in pairs if thrown)

    @property
    def fallen(self) -> tuple[str, ...]:
        """Names of the objects whose centre of mass is below the table's top."""
        # Environments call this in every control step: one kernel call for all objects.
        if not _find_fallen(self._qpos, self.qpos_at, self.mass_at, self._fallen):
            return ()
        pairs = zip(self.names, self._fallen.tolist(), strict=True)
        return tuple(name for name, fallen in pairs if fallen)

    def state(self) -> CoastingState:
        """Return a copy of the state."""
        return CoastingState(
            self.left_m.copy(), self.since_s.copy(), self._thrown.copy(), self._awake
        )

    def restore(self, state: CoastingState) -> None:
        """Restore a state that :meth:`state` returned."""
        self.left_m[:], self.since_s[:] = state.left_m, state.since_s
        self._thrown[:] = state.thrown
        self._awake, self.is_thrown = state.awake, bool(state.thrown.any())

    def middles(self) -> FloatArray:
        """Return world x, y of the objects' centres of mass, (objects, 2) [m]."""
        pairs = zip(self.qpos_at, self.mass_at, strict=True)
        found = [_middle(self._qpos, at, mass) for at, mass in pairs]
        return np.array(found).reshape(-1, 2)

    def led(self) -> NDArray[np.bool_]:
        """Return for each object whether a robot leads it now, (objects,)."""
        led, carried = np.zeros_like(self._held), np.zeros_like(self._held)
        note_leads(self._data.contact.geom, self.owner, led, carried)
        return led

    def note(self) -> None:
        """Record contacts. Call this after every physics step.

        Contacts with a pushed cube are intermittent: many last a single step.
        """
        if self._awake:
            note_leads(self._data.contact.geom, self.owner, self._held, self._resting)

    def look(self) -> None:
        """Evaluate the recorded contacts. Call this once per servo tick."""
        now, awake = self._data.time, self._awake
        if awake <= 1:
            if self._rest(now):
                self._awake = 0
                return
            self._awake = _REST_TICKS
            if not awake:
                self.note()
        else:
            slow = _are_slow(self._qvel, self.qvel_at)
            self._awake = awake - 1 if slow else _REST_TICKS
        self.is_thrown |= _follow(
            self._qpos,
            self.qpos_at,
            self.mass_at,
            self._held,
            self._resting,
            self.left_m,
            self.since_s,
            self._thrown,
            now,
        )


def _owners(model: mujoco.MjModel, bodies: list[int]) -> NDArray[np.int64]:
    """Return the owner of each geom, (ngeom,): an object, a robot or the room."""
    owner = np.full(model.ngeom, _ROOM, np.int64)
    for geom in range(model.ngeom):
        root = int(model.body_rootid[model.geom_bodyid[geom]])
        if root in bodies:
            owner[geom] = bodies.index(root)
        elif "/" in model.body(int(model.geom_bodyid[geom])).name:
            owner[geom] = _ROBOT
    return owner


@kernel
def _find_fallen(
    qpos: FloatArray,
    qpos_at: NDArray[np.int64],
    mass_at: FloatArray,
    fallen: NDArray[np.bool_],
) -> bool:
    """Write which objects are below the table's top; return whether any is."""
    found = False
    for k in range(len(qpos_at)):
        at = qpos_at[k]
        w, x, y, z = qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6]
        a, b, c = mass_at[k, 0], mass_at[k, 1], mass_at[k, 2]
        height = qpos[at + 2]
        height += 2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b
        height += (1.0 - 2.0 * (x * x + y * y)) * c
        fallen[k] = height < 0.0
        found |= fallen[k]
    return found


@kernel
def _middle(qpos: FloatArray, at: int, mass_at: FloatArray) -> tuple[float, float]:
    """Return world x, y of an object's centre of mass [m]."""
    w, x, y, z = qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6]
    a, b, c = mass_at[0], mass_at[1], mass_at[2]
    u = (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * ((x * y - w * z) * b)
    u += 2.0 * ((x * z + w * y) * c)
    v = (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * ((x * y + w * z) * a)
    v += 2.0 * ((y * z - w * x) * c)
    return qpos[at] + u, qpos[at + 1] + v


@kernel
def _are_slow(qvel: FloatArray, qvel_at: NDArray[np.int64]) -> bool:
    """Return whether all objects are slow."""
    for at in qvel_at:
        x, y, z = qvel[at], qvel[at + 1], qvel[at + 2]
        if x * x + y * y + z * z > _SLOW_M_S * _SLOW_M_S:
            return False
    return True


@kernel
def _rest(  # noqa: PLR0913
    qvel: FloatArray,
    qvel_at: NDArray[np.int64],
    qpos: FloatArray,
    qpos_at: NDArray[np.int64],
    mass_at: FloatArray,
    left_m: FloatArray,
    since_s: FloatArray,
    now: float,
) -> bool:
    """If all objects are slow, set their rest positions; return whether they are."""
    if not _are_slow(qvel, qvel_at):
        return False
    for k in range(len(qpos_at)):
        left_m[k, 0], left_m[k, 1] = _middle(qpos, qpos_at[k], mass_at[k])
        since_s[k] = now
    return True


@kernel
def note_leads(
    contacts: NDArray[np.int32],
    owner: NDArray[np.int64],
    held: NDArray[np.bool_],
    resting: NDArray[np.bool_],
) -> None:
    """Set flags of objects that a robot leads, and of objects that do not fly.

    Args:
        contacts: Both geoms of each contact, (ncon, 2).
        owner: Owner of each geom, (ngeom,).
        held: Set for objects that a robot leads, (objects,).
        resting: Set for objects in contact with robot or room, also through other
            objects, (objects,).
    """
    led, carried = np.zeros_like(held), np.zeros_like(held)
    changed = True
    while changed:
        changed = False
        for c in range(len(contacts)):
            a, b = owner[contacts[c, 0]], owner[contacts[c, 1]]
            for k, other in ((a, b), (b, a)):
                if k < 0:
                    continue
                if not led[k] and (other == _ROBOT or (other >= 0 and led[other])):
                    led[k] = changed = True
                if not carried[k] and (other < 0 or carried[other]):
                    carried[k] = changed = True
    for k in range(len(held)):
        held[k] |= led[k]
        resting[k] |= carried[k]


@kernel
def _follow(  # noqa: PLR0913
    qpos: FloatArray,
    qpos_at: NDArray[np.int64],
    mass_at: FloatArray,
    held: NDArray[np.bool_],
    resting: NDArray[np.bool_],
    left_m: FloatArray,
    since_s: FloatArray,
    thrown: NDArray[np.bool_],
    now: float,
) -> bool:
    """Evaluate and clear the flags; return whether an object is newly thrown."""
    newly = False
    for k in range(len(held)):
        x, y = _middle(qpos, qpos_at[k], mass_at[k])
        if held[k]:
            left_m[k, 0], left_m[k, 1] = x, y
        if resting[k]:
            since_s[k] = now
        dx, dy = x - left_m[k, 0], y - left_m[k, 1]
        far = dx * dx + dy * dy > COAST_M * COAST_M
        if (far or now - since_s[k] > FLIGHT_S) and not thrown[k]:
            thrown[k] = newly = True
        held[k] = resting[k] = False
    return newly
