"""Kernels that advance the physics by servo ticks, with motor commands of all arms.

There is one kernel for each control mode. Before each physics step it advances
references, applies the safety filter and writes the commands. Each takes a
:data:`Team` and then the action.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lemma.core.kernels import borrowed, kernel
from lemma.core.poses import FloatArray
from lemma.env.control.safety_filter import Guard, find_obstacles, keep_clear
from lemma.motion.arm_motion import POSTURE_ALONE, SUBSTEP_S, SUBSTEPS
from lemma.motion.rmpflow.policy import integrate, solve
from lemma.scene.build import STEPS_PER_TICK, TIME_STEP_S
from lemma.scene.coasting import Physics, look, step

Team = tuple[
    Physics, Guard, NDArray[np.void], FloatArray, FloatArray, NDArray[np.int64]
]
"""The physics, obstacles of the safety filter, and of n arms: records, (n,), see
:data:`~lemma.env.control.guarded_arm.ARM`; references, (n, 2, 6) [rad, rad/s]; openings
of the grippers, (n,) [m]; and in how many servo ticks each moved, (n,)."""

ACCELERATION_RAD_S2 = 10.0
"""Largest acceleration of a joint's reference, which a stretched arm can follow."""

SWING_RAD = 0.25
"""An arm whose base joint has to turn further than this swings around first."""
_MOVING_RAD_S = 0.02
_MOVING_M_S = 0.002


@kernel(nogil=True)
def run_positions(team: Team, targets: FloatArray, ticks: int) -> None:
    """Move joints to angles, (n, 6) [rad], with trapezoidal velocity profiles."""
    physics, guard, records, states, openings, counts = team
    qpos, control = borrowed(physics[10]), borrowed(physics[12])
    obstacles, objects = borrowed(guard[2]), borrowed(guard[3])
    states, targets = borrowed(states), borrowed(targets)
    for _ in range(ticks):
        find_obstacles(guard, records, qpos)
        for _ in range(STEPS_PER_TICK):
            for k in range(records.shape[0]):
                arm, state = records[k], states[k]
                approach(state, targets[k], arm.speeds)
                keep_clear(arm, obstacles[k], objects[k], state[0], state[1])
                advance(state, arm.range)
                _send_reference(arm, state, openings[k], qpos, control)
            step(physics)
        end(physics, records, counts)


@kernel(nogil=True)
def run_velocities(team: Team, wanted: FloatArray, ticks: int) -> None:
    """Move joints at speeds, (n, 6) [rad/s]; reference angles are the measured ones."""
    physics, guard, records, states, openings, counts = team
    qpos, control = borrowed(physics[10]), borrowed(physics[12])
    obstacles, objects = borrowed(guard[2]), borrowed(guard[3])
    states, wanted = borrowed(states), borrowed(wanted)
    for _ in range(ticks):
        find_obstacles(guard, records, qpos)
        for _ in range(STEPS_PER_TICK):
            for k in range(records.shape[0]):
                arm, state = records[k], states[k]
                state[0] = qpos[arm.qpos : arm.qpos + 6]
                accelerate(state, wanted[k], arm.speeds, arm.range)
                keep_clear(arm, obstacles[k], objects[k], state[0], state[1])
                control[arm.ctrl : arm.ctrl + 6] = state[1]
                control[arm.gripper_ctrl] = openings[k]
            step(physics)
        end(physics, records, counts)


@kernel(nogil=True)
def run_poses(
    team: Team, workspaces: np.ndarray, spheres: FloatArray, swings: bool, ticks: int
) -> None:
    """Follow RMPflow, given its records (n,) and spheres (n, m, 6).

    If an arm ``swings``, it moves in joint space while its base has far to turn.
    """
    physics, guard, records, states, openings, counts = team
    qpos, control = borrowed(physics[10]), borrowed(physics[12])
    obstacles, objects = borrowed(guard[2]), borrowed(guard[3])
    states, spheres = borrowed(states), borrowed(spheres)
    before, rates = np.empty(6), np.empty(6)
    for _ in range(ticks):
        find_obstacles(guard, records, qpos)
        if swings:
            swing_far(states, workspaces)
        for _ in range(STEPS_PER_TICK):
            for k in range(records.shape[0]):
                arm, state = records[k], states[k]
                before[:] = state[0]
                workspace = workspaces[k : k + 1]
                integrate(
                    workspace, spheres[k], state, obstacles[k], SUBSTEP_S, SUBSTEPS
                )
                for i in range(6):
                    rates[i] = (state[0, i] - before[i]) / TIME_STEP_S
                if keep_clear(arm, obstacles[k], objects[k], before, rates):
                    for i in range(6):
                        state[0, i] = before[i] + TIME_STEP_S * rates[i]
                        state[1, i] = rates[i]
                _send_reference(arm, state, openings[k], qpos, control)
            step(physics)
        end(physics, records, counts)


@kernel
def step_torques(
    team: Team,
    wanted: FloatArray,
    matrix: FloatArray,
    bias_forces: FloatArray,
    passive_forces: FloatArray,
) -> None:
    """Apply torques, (n, 6) [N m], as far as the joints' velocity limits allow.

    This is a single physics step. The last arguments are the inertia matrix of the
    scene, and its joint forces.
    """
    physics, guard, records, states, openings, _ = team
    qpos, qvel, control = physics[10:]
    obstacles, objects = borrowed(guard[2]), borrowed(guard[3])
    states, wanted = borrowed(states), borrowed(wanted)
    inertia, bias, rates = np.empty((6, 6)), np.empty(6), np.empty(6)
    for k in range(records.shape[0]):
        arm, state, start = records[k], states[k], records[k].dof
        for i in range(6):
            state[0, i] = qpos[arm.qpos + i]
            state[1, i] = qvel[start + i]
            bias[i] = bias_forces[start + i] - passive_forces[start + i]
            for j in range(6):
                inertia[i, j] = matrix[start + i, start + j]
        predict(inertia, bias, wanted[k], state[1], rates)
        bounded = bound(state[0], rates, arm.speeds, arm.range)
        guarded = keep_clear(arm, obstacles[k], objects[k], state[0], rates)
        torques = wanted[k].copy()
        if bounded or guarded:
            steer(inertia, bias, rates - state[1], arm.efforts, torques)
        control[arm.ctrl : arm.ctrl + 6] = torques
        control[arm.gripper_ctrl] = openings[k]
    step(physics)


@kernel
def end(physics: Physics, records: np.ndarray, counts: NDArray[np.int64]) -> None:
    """End a servo tick: look at the objects, and count it for each arm that moves.

    An arm moves if a joint is faster than 0.02 rad/s or a finger is faster than 2 mm/s.
    """
    look(physics)
    qvel = physics[11]
    for k in range(records.shape[0]):
        start, moving = records[k].dof, False
        for i in range(8):
            if abs(qvel[start + i]) > (_MOVING_RAD_S if i < 6 else _MOVING_M_S):
                moving = True
        counts[k] += moving


@kernel
def swing_far(states: FloatArray, workspaces: np.ndarray) -> None:
    """Select joint-space motion for arms whose base has far to turn, else straight.

    Args:
        states: The references of n arms, (n, 2, 6) [rad, rad/s].
        workspaces: The records of RMPflow, (n,), each with a posture; their weights are
            written.
    """
    for k in range(states.shape[0]):
        goal = workspaces[k].goal
        far = abs(goal.posture[0] - states[k, 0, 0]) > SWING_RAD
        goal.target_weight = 0.0 if far else 1.0
        goal.posture_weight = POSTURE_ALONE if far else 1.0


@kernel
def _send_reference(
    arm: np.record,
    state: FloatArray,
    opening: float,
    qpos: FloatArray,
    control: FloatArray,
) -> None:
    """Send a reference to position servos, with lead compensation for their lag.

    Commands are limited so that servos do not exceed the joints' velocity limits: a
    servo's torque is zero where ``(control - q) / lag`` equals the speed, so bounding
    this term bounds the speed.
    """
    for i in range(6):
        command = state[0, i] + arm.lag_s * state[1, i]
        q, span = qpos[arm.qpos + i], arm.lag_s * arm.speeds[i]
        control[arm.ctrl + i] = min(q + span, max(q - span, command))
    control[arm.gripper_ctrl] = opening


# Limits of a joint within a physics step: speeds, accelerations and torques.


@kernel
def approach(state: FloatArray, target: FloatArray, speeds: FloatArray) -> None:
    """Advance the speeds of a reference, (2, 6), by one physics step.

    They become the largest speeds from which each joint can still stop at its target.
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
    """Bound joint speeds, (6,), in place; return whether any changed.

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
    """Write the joint speeds, (6,), that torques cause after a physics step to ``out``.

    Args:
        inertia: (6, 6) [kg m2].
        bias: Torques for zero joint acceleration, (6,) [N m].
        torques: (6,) [N m].
        rates: Joint speeds now, (6,) [rad/s].
        out: Receives the result, (6,) [rad/s].
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
    """Write the torques, (6,), that reach given joint speeds within a physics step.

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
