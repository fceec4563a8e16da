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

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mj_step, mujoco
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.scene.objects.contacts import note_bad

COAST_M = 0.04
"""Largest horizontal distance of an object's centre of mass from its position when a
robot last led it, or when it last rested [m]."""
FLIGHT_S = 0.15
"""Longest flight [s], which corresponds to a fall of 11 cm."""

_SLOW_M_S = 0.02
_REST_TICKS = 10
"""Number of servo ticks that all objects must be slow to count as resting."""
_ROOM, _ROBOT = -1, -2


OBJECT = np.dtype(
    [
        ("qpos_at", np.int64),
        ("qvel_at", np.int64),
        ("mass_at", np.float64, 3),
        ("left_m", np.float64, 2),
        ("since_s", np.float64),
        # Since the last look: whether a robot led it, and whether it did not fly.
        ("held", np.bool_),
        ("resting", np.bool_),
        ("thrown", np.bool_),
    ],
    align=True,
)
"""Record of an object; see the attributes of :class:`Coasting`."""

_Indices = NDArray[np.int64]
Physics = tuple[
    _Indices,
    FloatArray,
    NDArray[np.int32],
    NDArray[np.int32],
    _Indices,
    _Indices,
    NDArray[np.void],
    _Indices,
    NDArray[np.bool_],
    _Indices,
    FloatArray,
    FloatArray,
    FloatArray,
]
"""All that kernels need to advance the physics of a scene: the four arrays of
:data:`~lemma.core.engine.Memory`; ``owner``, ``flags`` and ``objects`` of
:class:`Coasting`; ``who``, ``bad`` and ``first`` of :class:`.ForbiddenContacts`; and
positions, velocities and motor commands. It is a plain tuple, because Numba takes
those fastest."""


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
        bodies = [int(model.jnt_bodyid[j]) for j in free]
        self._data = data
        self._qpos = data.qpos
        self.objects = np.zeros(len(free), OBJECT)
        """A record of each object."""
        self.objects["qpos_at"] = model.jnt_qposadr[free]
        self.objects["qvel_at"] = model.jnt_dofadr[free]
        self.objects["mass_at"] = model.body_ipos[bodies].reshape(-1, 3)
        self.qpos_at = self.objects["qpos_at"].copy()
        """Address of each object's position in ``qpos``, (objects,)."""
        self.qvel_at = self.objects["qvel_at"].copy()
        """Address of each object's velocity in ``qvel``, (objects,)."""
        self.mass_at = self.objects["mass_at"].copy()
        """Centre of mass of each object in its frame, (objects, 3) [m]."""
        self.owner = _owners(model, bodies)
        """Owner of each geom, (ngeom,): index of an object; negative for the room or a
        robot."""
        self.names = tuple(model.body(body).name for body in bodies)
        """The objects that are not fixed to the table."""
        self.left_m: FloatArray = self.objects["left_m"]
        """World x, y of each object's centre of mass when a robot last led it or it
        last rested, (objects, 2) [m]."""
        self.since_s: FloatArray = self.objects["since_s"]
        """Simulated time of each object's last contact, (objects,) [s]."""
        self._thrown = self.objects["thrown"]
        self._fallen = np.zeros(len(free), np.bool_)
        self.flags = np.zeros(2, np.int64)
        """How many servo ticks it goes on to note contacts, 0 if all objects rest; and
        whether any has been thrown."""
        for name in self.names:
            self.put(name)

    def put(self, name: str) -> None:
        """Reset the tracking of an object that was moved to its present pose."""
        k = self.names.index(name)
        self.left_m[k] = _middle(self._qpos, self.qpos_at[k], self.mass_at[k])
        self.since_s[k] = self._data.time

    @property
    def is_thrown(self) -> bool:
        """Whether an object has been thrown."""
        return bool(self.flags[1])

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
        copies = self.left_m.copy(), self.since_s.copy(), self._thrown.copy()
        return CoastingState(*copies, int(self.flags[0]))

    def restore(self, state: CoastingState) -> None:
        """Restore a state that :meth:`state` returned."""
        self.left_m[:], self.since_s[:] = state.left_m, state.since_s
        self._thrown[:] = state.thrown
        self.flags[:] = state.awake, state.thrown.any()

    def middles(self) -> FloatArray:
        """Return world x, y of the objects' centres of mass, (objects, 2) [m]."""
        pairs = zip(self.qpos_at, self.mass_at, strict=True)
        found = [_middle(self._qpos, at, mass) for at, mass in pairs]
        return np.array(found).reshape(-1, 2)

    def led(self) -> NDArray[np.bool_]:
        """Return for each object whether a robot leads it now, (objects,)."""
        led, carried = np.zeros((2, len(self.names)), np.bool_)
        note_leads(self._data.contact.geom, self.owner, led, carried)
        return led


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
def _are_slow(objects: NDArray[np.void], qvel: FloatArray) -> bool:
    """Return whether all objects are slow."""
    for k in range(len(objects)):
        at = objects[k].qvel_at
        x, y, z = qvel[at], qvel[at + 1], qvel[at + 2]
        if x * x + y * y + z * z > _SLOW_M_S * _SLOW_M_S:
            return False
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


@kernel(nogil=True)
def step(physics: Physics) -> None:
    """Advance the physics by one step, and note contacts.

    Contacts with a pushed cube are intermittent: many last a single step. So do those
    of a robot that knocks against something.
    """
    addresses, _, count, geoms, owner, flags, objects, who, bad, first = physics[:10]
    mj_step(addresses)
    contacts = geoms[: count[0]]
    if flags[0] > 0:
        note_leads(contacts, owner, objects["held"], objects["resting"])
    note_bad(contacts, who, bad, first)


@kernel(nogil=True)
def follow(physics: Physics, commands: FloatArray, ticks: int) -> None:
    """Run servo ticks, each with the same motor commands, (steps, nu)."""
    control = physics[12]
    for _ in range(ticks):
        for row in commands:
            control[:] = row
            step(physics)
        look(physics)


@kernel
def look(physics: Physics) -> None:
    """Evaluate the noted contacts, at the end of a servo tick."""
    _, time, count, geoms, owner, flags, objects = physics[:7]
    qpos, qvel = physics[10:12]
    now, awake = time[0], flags[0]
    slow = _are_slow(objects, qvel)
    if awake <= 1 and slow:
        flags[0] = 0
        for k in range(len(objects)):
            _leave(objects[k], qpos)
            objects[k].since_s = now
        return
    flags[0] = awake - 1 if slow else _REST_TICKS
    if awake == 0:
        note_leads(geoms[: count[0]], owner, objects["held"], objects["resting"])
    for k in range(len(objects)):
        if _is_thrown(objects[k], qpos, now):
            flags[1] = 1


@kernel
def _leave(thing: np.record, qpos: FloatArray) -> None:
    """Set where an object was when a robot last led it, to where it is."""
    x, y = _middle(qpos, thing.qpos_at, thing.mass_at)
    thing.left_m[0], thing.left_m[1] = x, y


@kernel
def _is_thrown(thing: np.record, qpos: FloatArray, now: float) -> bool:
    """Evaluate and clear what was noted; return whether the object has been thrown."""
    if thing.held:
        _leave(thing, qpos)
    if thing.resting:
        thing.since_s = now
    x, y = _middle(qpos, thing.qpos_at, thing.mass_at)
    dx, dy = x - thing.left_m[0], y - thing.left_m[1]
    far = dx * dx + dy * dy > COAST_M * COAST_M
    if far or now - thing.since_s > FLIGHT_S:
        thing.thrown = True
    thing.held = thing.resting = False
    thrown: bool = thing.thrown
    return thrown
