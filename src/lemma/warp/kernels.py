"""Kernels between the physics steps of MuJoCo Warp: servos, contacts, throws."""

import math

import warp as wp

from lemma.env.control.motor_commands import ACCELERATION_RAD_S2
from lemma.scene.build import TIME_STEP_S
from lemma.scene.coasting import COAST_M, FLIGHT_S
from lemma.warp.instances import PARKED_M

_H, _A = wp.constant(TIME_STEP_S), wp.constant(ACCELERATION_RAD_S2)
_STEEP = wp.constant(math.cos(math.radians(30.0)))
_COAST, _FLIGHT = wp.constant(COAST_M), wp.constant(FLIGHT_S)
_PARKED = wp.constant(0.5 * PARKED_M)


@wp.kernel
def drive(
    qpos: wp.array2d(dtype=float),  # type: ignore[valid-type]
    targets: wp.array2d(dtype=float),  # type: ignore[valid-type]
    numbers: wp.array2d(dtype=float),  # type: ignore[valid-type]
    addresses: wp.array2d(dtype=int),  # type: ignore[valid-type]
    angle: wp.array2d(dtype=float),  # type: ignore[valid-type]
    rate: wp.array2d(dtype=float),  # type: ignore[valid-type]
    ctrl: wp.array2d(dtype=float),  # type: ignore[valid-type]
) -> None:
    """Advance the reference of each joint, as ``run_positions`` on the CPU.

    There is no safety filter. ``numbers`` has speed, lag and range of each joint, and
    ``addresses`` its indices in ``qpos`` and ``ctrl``.
    """
    w, j = wp.tid()
    speed, lag, limit = numbers[j, 0], numbers[j, 1], numbers[j, 2]
    error = targets[w, j] - angle[w, j]
    gap = wp.abs(error)
    most = 0.5 * (wp.sqrt(_A * _H * _A * _H + 8.0 * _A * gap) - _A * _H)
    most = wp.min(most, wp.min(speed, gap / _H))
    change = wp.sign(error) * most - rate[w, j]
    v = rate[w, j] + wp.clamp(change, -_A * _H, _A * _H)
    q = angle[w, j] + v * _H
    if wp.abs(q) > limit:
        q = wp.clamp(q, -limit, limit)
        v = float(0.0)
    angle[w, j] = q
    rate[w, j] = v
    here = qpos[w, addresses[j, 0]]
    span = lag * speed
    ctrl[w, addresses[j, 1]] = wp.clamp(q + lag * v, here - span, here + span)


@wp.kernel
def note(
    count: wp.array(dtype=int),  # type: ignore[valid-type]
    worlds: wp.array(dtype=int),  # type: ignore[valid-type]
    geoms: wp.array(dtype=wp.vec2i),  # type: ignore[valid-type]
    frames: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
    owner: wp.array(dtype=int),  # type: ignore[valid-type]
    objects: int,
    touch: wp.array3d(dtype=int),  # type: ignore[valid-type]
) -> None:
    """Record the owners in contact with each object as three bit masks.

    The masks are of all contacts, of contacts from below, and of those not from above.
    Owner 0 is the room, then come the objects, then palm, left and right pad of each
    robot.
    """
    c = wp.tid()
    if c >= count[0]:
        return
    w, pair = worlds[c], geoms[c]
    rise = float(frames[c][0, 2])
    for side in range(2):
        a = int(owner[pair[side]])
        b = int(owner[pair[1 - side]])
        if a >= 1 and a <= objects:
            bit = wp.int32(1) << b
            wp.atomic_or(touch, w, a - 1, 0, bit)
            if rise <= -_STEEP:
                wp.atomic_or(touch, w, a - 1, 1, bit)
            if rise < _STEEP:
                wp.atomic_or(touch, w, a - 1, 2, bit)
        rise = -rise


@wp.kernel
def follow(  # noqa: PLR0913
    qpos: wp.array2d(dtype=float),  # type: ignore[valid-type]
    qvel: wp.array2d(dtype=float),  # type: ignore[valid-type]
    addresses: wp.array2d(dtype=int),  # type: ignore[valid-type]
    robots: int,
    room: int,
    touch: wp.array3d(dtype=int),  # type: ignore[valid-type]
    left: wp.array3d(dtype=float),  # type: ignore[valid-type]
    awake: wp.array(dtype=int),  # type: ignore[valid-type]
    thrown: wp.array(dtype=int),  # type: ignore[valid-type]
) -> None:
    """Detect objects that move without a robot, as :mod:`lemma.scene.coasting`.

    ``left`` has the position at which each movable object was last touched by a robot,
    and the time without any contact [s].
    """
    w = wp.tid()
    count = addresses.shape[0]
    led = int(0)
    carried = int(0)
    fast = int(0)
    for _ in range(count):
        for k in range(count):
            t = int(touch[w, k, 0])
            bit = wp.int32(2) << k
            if (t & (robots | led)) != 0:
                led = led | bit
            if (t & (robots | room | carried)) != 0:
                carried = carried | bit
    for k in range(count):
        v = int(addresses[k, 1])
        speed = wp.vec3(qvel[w, v], qvel[w, v + 1], qvel[w, v + 2])
        if wp.length(speed) > 0.02:
            fast = int(1)
    if fast == 1:
        awake[w] = 20
    elif awake[w] > 0:
        awake[w] = awake[w] - 1
    for k in range(count):
        at = int(addresses[k, 0])
        bit = wp.int32(2) << k
        if qpos[w, at + 2] > _PARKED:
            # Nothing carries a parked object, so it would count as one that flies.
            continue
        x = float(qpos[w, at])
        y = float(qpos[w, at + 1])
        if awake[w] == 0 or (led & bit) != 0:
            left[w, k, 0] = x
            left[w, k, 1] = y
        left[w, k, 2] = left[w, k, 2] + _H
        if awake[w] == 0 or (carried & bit) != 0:
            left[w, k, 2] = float(0.0)
        dx = x - left[w, k, 0]
        dy = y - left[w, k, 1]
        if dx * dx + dy * dy > _COAST * _COAST or left[w, k, 2] > _FLIGHT:
            thrown[w] = 1
