"""Limits of a joint within a physics step: speeds, accelerations and torques.

Plain loops, compiled: the same numbers on every machine.
"""

import math

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.policy import solve
from lemma.scene.build import TIME_STEP_S

ACCELERATION_RAD_S2 = 10.0
"""Largest acceleration of a joint's reference: what a stretched arm can follow."""


@kernel
def approach(state: FloatArray, target: FloatArray, speeds: FloatArray) -> None:
    """Advance the speeds of a reference, (2, 6), by one physics step.

    They become the largest from which each joint can still stop at its target.
    """
    h, a = TIME_STEP_S, ACCELERATION_RAD_S2
    for i in range(6):
        error = target[i] - state[0, i]
        gap = abs(error)
        speed = 0.5 * (math.sqrt(a * h * a * h + 8.0 * a * gap) - a * h)
        speed = min(speed, speeds[i], gap / h)
        wanted = speed if error > 0.0 else -speed
        change = min(a * h, max(-a * h, wanted - state[1, i]))
        state[1, i] += change


@kernel
def advance(state: FloatArray, limits: FloatArray) -> None:
    """Advance the angles of a reference, (2, 6), by one physics step."""
    for i in range(6):
        state[0, i] += state[1, i] * TIME_STEP_S
        if abs(state[0, i]) > limits[i]:
            state[0, i] = min(limits[i], max(-limits[i], state[0, i]))
            state[1, i] = 0.0


@kernel
def accelerate(
    state: FloatArray, wanted: FloatArray, speeds: FloatArray, limits: FloatArray
) -> None:
    """Advance the speeds of a reference, (2, 6), by one physics step.

    A joint slows down so that it stops before the end of its range.
    """
    most = ACCELERATION_RAD_S2 * TIME_STEP_S
    goal = wanted.copy()
    bound(state[0], goal, speeds, limits)
    for i in range(6):
        state[1, i] += min(most, max(-most, goal[i] - state[1, i]))


@kernel
def bound(
    q: FloatArray, rates: FloatArray, speeds: FloatArray, limits: FloatArray
) -> bool:
    """Bound joint speeds, (6,), in place; return whether that was needed.

    A joint slows down so that it stops before the end of its range.
    """
    changed = False
    for i in range(6):
        span = 2.0 * ACCELERATION_RAD_S2
        up = min(speeds[i], math.sqrt(span * max(0.0, limits[i] - q[i])))
        down = min(speeds[i], math.sqrt(span * max(0.0, limits[i] + q[i])))
        if not -down <= rates[i] <= up:
            rates[i] = min(up, max(-down, rates[i]))
            changed = True
    return changed


@kernel
def predict(
    inertia: FloatArray,
    bias: FloatArray,
    torques: FloatArray,
    rates: FloatArray,
    out: FloatArray,
) -> None:
    """Write the joint speeds, (6,), that torques lead to in a physics step to ``out``.

    Args:
        inertia: (6, 6) [kg m2].
        bias: Torques that keep the joints from accelerating, (6,) [N m].
        torques: (6,) [N m].
        rates: Joint speeds now, (6,) [rad/s].
        out: Written.
    """
    solve(inertia.copy(), torques - bias, out)
    for i in range(6):
        out[i] = rates[i] + TIME_STEP_S * out[i]


@kernel
def steer(
    inertia: FloatArray,
    bias: FloatArray,
    change: FloatArray,
    efforts: FloatArray,
    out: FloatArray,
) -> None:
    """Write the torques, (6,), that change the joint speeds within a physics step.

    If a motor is too weak, all joints change less, in proportion.
    """
    scale = 1.0
    for i in range(6):
        out[i] = 0.0
        for j in range(6):
            out[i] += inertia[i, j] * change[j] / TIME_STEP_S
    for i in range(6):
        room = efforts[i] - bias[i] if out[i] > 0.0 else efforts[i] + bias[i]
        if abs(out[i]) * scale > room:
            scale = max(0.0, room) / abs(out[i])
    for i in range(6):
        out[i] = min(efforts[i], max(-efforts[i], bias[i] + scale * out[i]))
