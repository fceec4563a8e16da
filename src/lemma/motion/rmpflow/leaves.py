"""The leaves of RMPflow: desired acceleration and metric of each.

Each leaf is a second-order policy in its own task space: a desired acceleration and a
metric that weighs it against the other leaves (Ratliff et al., *Riemannian Motion
Policies*, 2018; Cheng et al., *RMPflow*, 2018). The formulas are those of NVIDIA's
Lula, with NVIDIA's published parameters for the UR10 where there are any.
"""

import math
from typing import NamedTuple

from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray


class TargetLeaf(NamedTuple):
    """Attracts the tool centre point to a position."""

    gain: float = 110.0
    damping: float = 120.0
    epsilon_m: float = 0.075
    """Below this distance the attraction decreases linearly."""
    near_sigma_m: float = 0.05
    near_floor: float = 0.01
    near_metric: float = 10000.0
    far_metric: float = 2500.0
    boost: float = 20.0
    """Factor of the metric at the target, relative to far away."""
    boost_sigma_m: float = 0.02


class AxisLeaf(NamedTuple):
    """Aligns an axis of the gripper with a direction."""

    gain: float = 200.0
    damping: float = 40.0
    metric: float = 1000.0
    boost: float = 30.0
    boost_sigma_m: float = 0.05


class PostureLeaf(NamedTuple):
    """Attracts the joints to a posture, which selects one of the kinematic branches."""

    gain: float = 200.0
    damping: float = 50.0
    cap_rad: float = 1.5
    metric: float = 50.0
    inertia: float = 1.0


class JointLimitLeaf(NamedTuple):
    """Keeps a joint inside its range."""

    gain: float = 1.0
    damping: float = 200.0
    gain_length: float = 0.1
    gain_epsilon: float = 0.01
    metric: float = 1000.0
    metric_length: float = 0.01
    metric_epsilon: float = 0.001
    velocity_gate: float = 0.01
    buffer_rad: float = 0.01


class VelocityCapLeaf(NamedTuple):
    """Brakes a joint close to its velocity limit."""

    limit_fraction: float = 0.95
    """Fraction of the motor's limit; the rest is for the servo's overshoot."""
    region_rad_s: float = 0.5
    damping: float = 300.0
    metric: float = 100.0


class CollisionLeaf(NamedTuple):
    """Keeps a point of the arm away from an obstacle.

    The metric is that of NVIDIA's Franka parameters. With 500, that of the UR10, and
    realistic motor limits, an arm at full speed runs up to 2 cm into an obstacle.
    """

    gain: float = 1000.0
    gain_length_m: float = 0.01
    damping: float = 50.0
    damping_length_m: float = 0.04
    damping_epsilon: float = 0.01
    velocity_gate: float = 0.01
    metric: float = 10000.0
    metric_length_m: float = 0.02
    metric_epsilon: float = 0.001


class DampingLeaf(NamedTuple):
    """Damps fast motion."""

    damping: float = 30.0
    metric: float = 50.0
    inertia: float = 100.0


class Leaves(NamedTuple):
    """The parameters of all leaves and of the root."""

    target: TargetLeaf = TargetLeaf()
    axis: AxisLeaf = AxisLeaf()
    posture: PostureLeaf = PostureLeaf()
    joint_limit: JointLimitLeaf = JointLimitLeaf()
    velocity_cap: VelocityCapLeaf = VelocityCapLeaf()
    collision: CollisionLeaf = CollisionLeaf()
    damping: DampingLeaf = DampingLeaf()
    max_acceleration: float = 12.0
    """Bound on the norm of the joint accelerations [rad/s2]."""


@kernel
def sigmoid(x: float) -> float:
    """Return the logistic function, without overflow."""
    e = math.exp(-abs(x))
    return (1.0 if x >= 0 else e) / (1.0 + e)


@kernel
def target(
    leaf: TargetLeaf,
    error: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    metric: FloatArray,
) -> float:
    """Evaluate the target leaf.

    Args:
        leaf: Parameters.
        error: Target minus position, (3,) [m].
        velocity: Of the tool centre point, (3,) [m/s].
        acceleration: Written, (3,) [m/s2].
        metric: Written, (3, 3).

    Returns:
        The distance to the target [m].
    """
    distance = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    pull = leaf.gain / (distance + leaf.epsilon_m)
    near = (1.0 - leaf.near_floor) * math.exp(
        -0.5 * (distance / leaf.near_sigma_m) ** 2
    ) + leaf.near_floor
    weight = boost(leaf.boost, leaf.boost_sigma_m, distance)
    unit = 1.0 / max(distance, 1e-9)
    for i in range(3):
        acceleration[i] = pull * error[i] - leaf.damping * velocity[i]
        for j in range(3):
            along = error[i] * unit * error[j] * unit
            same = 1.0 if i == j else 0.0
            metric[i, j] = weight * (
                near * leaf.near_metric * same + (1.0 - near) * leaf.far_metric * along
            )
    return distance


@kernel
def axes(
    leaf: AxisLeaf,
    rotation: FloatArray,
    goal: FloatArray,
    omega: FloatArray,
    distance: float,
    acceleration: FloatArray,
) -> float:
    """Evaluate the axis leaves of all three axes of a frame, as one.

    Each axis n is aligned with m by ``ndd = gain (m - n) - damping nd``, with a scalar
    metric. Pulled back to rotations by ``nd = omega x n``, the sum over an orthonormal
    frame is one angular acceleration, ``gain / 2 sum n x m - damping omega``, with
    twice that metric.

    Args:
        leaf: Parameters.
        rotation: Present axes in columns, (3, 3) or a transform (4, 4).
        goal: Axes to turn to, (3, 3).
        omega: Angular velocity, (3,) [rad/s].
        distance: Distance of the tool centre point from its target [m].
        acceleration: Written: angular acceleration, (3,) [rad/s2].

    Returns:
        The metric, as a factor of the identity matrix.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cross = 0.0
        for axis in range(3):
            cross += rotation[j, axis] * goal[k, axis]
            cross -= rotation[k, axis] * goal[j, axis]
        acceleration[i] = 0.5 * leaf.gain * cross - leaf.damping * omega[i]
    return 2.0 * leaf.metric * boost(leaf.boost, leaf.boost_sigma_m, distance)


@kernel
def boost(factor: float, sigma_m: float, distance: float) -> float:
    """Return a factor that grows from 1 far away to ``factor`` at the target.

    Args:
        factor: Value at the target.
        sigma_m: Length scale of the growth [m].
        distance: Distance from the target [m].
    """
    beta = math.exp(-0.5 * (distance / sigma_m) ** 2)
    return beta * factor + (1.0 - beta)


@kernel
def joint_limit(
    leaf: JointLimitLeaf, distance: float, velocity: float
) -> tuple[float, float]:
    """Evaluate one side of a joint's range.

    Args:
        leaf: Parameters.
        distance: Distance to the limit, as a fraction of the range; positive inside.
        velocity: Rate of the distance [1/s]; negative towards the limit.

    Returns:
        Acceleration away from the limit [1/s2], and metric.
    """
    x = max(distance, 0.0)
    acceleration = (
        leaf.gain / ((x / leaf.gain_length) ** 2 + leaf.gain_epsilon)
        - leaf.damping * velocity
    )
    gate = 1.0 - sigmoid(velocity / leaf.velocity_gate)
    return acceleration, gate * leaf.metric / (
        x / leaf.metric_length + leaf.metric_epsilon
    )


@kernel
def velocity_cap(
    leaf: VelocityCapLeaf, velocity: float, limit: float
) -> tuple[float, float]:
    """Evaluate the velocity cap of one joint.

    Args:
        leaf: Parameters.
        velocity: Velocity of the joint [rad/s].
        limit: The joint's velocity limit [rad/s].

    Returns:
        Acceleration [rad/s2] and metric; both are zero at lower velocities.
    """
    excess = abs(velocity) - (limit * leaf.limit_fraction - leaf.region_rad_s)
    if excess <= 0.0:
        return 0.0, 0.0
    sign = 1.0 if velocity > 0 else -1.0
    ratio = min(excess / leaf.region_rad_s, 0.999)
    return -sign * leaf.damping * excess, leaf.metric / (1.0 - ratio * ratio)


@kernel
def collision(
    leaf: CollisionLeaf, distance: float, velocity: float, radius: float
) -> tuple[float, float]:
    """Evaluate one point of the arm against one obstacle.

    Args:
        leaf: Parameters.
        distance: Distance between the surfaces [m].
        velocity: Rate of the distance [m/s]; negative when approaching.
        radius: Distance beyond which the obstacle is ignored [m].

    Returns:
        Acceleration away from the obstacle [m/s2], and metric.
    """
    if distance >= radius:
        return 0.0, 0.0
    x = max(distance, 0.0)
    gate = 1.0 - sigmoid(velocity / leaf.velocity_gate)
    acceleration = leaf.gain * math.exp(-x / leaf.gain_length_m) - (
        leaf.damping
        * gate
        * velocity
        / (x / leaf.damping_length_m + leaf.damping_epsilon)
    )
    fade = (1.0 - x / radius) ** 2
    return acceleration, gate * fade * leaf.metric / (
        x / leaf.metric_length_m + leaf.metric_epsilon
    )
