"""Elementary motions of one arm: to a waypoint, along a line, grasp, release, park.

Each motion is a generator that yields once per servo tick and raises
:class:`SkillFailure` if it cannot continue.
"""

import math
from collections.abc import Generator
from itertools import pairwise

import numpy as np

from lemma.core.poses import FloatArray, wrap
from lemma.motion.arm_motion import ArmMotion, largest_turn, nearest_turn
from lemma.motion.outcome import Outcome, SkillFailure
from lemma.robots.collision_model import (
    obstacle_clearance,
    self_clearance,
    table_clearance,
)
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import GRASP_HEIGHT_M, TRAVEL_HEIGHT_M, gripper_ik
from lemma.robots.ur.kinematics import top_down
from lemma.scene.build import TICK_S

Motion = Generator[None, None, None]
Stand = tuple[float, float, float, float]
"""Pose of a gripper that points down: x, y, z of the tool centre point [m], yaw [rad].
"""

RETREAT_M = 0.13
"""Height by which the gripper rises before the arm swings away."""
FLY_BY_M = 0.03
"""Tolerance of a waypoint at which the arm does not stop."""

_VERTICAL_M_S = 0.5
_TOUCHDOWN_M = 0.03
_TOUCHDOWN_M_S = 0.12
_FLY_BY_RAD = 0.15
_ARRIVED_M = 0.002
_ARRIVED_RAD = 0.02
_LAID_M = 0.0007
_PARKED_RAD = 0.05
_TOUCHED_M = 0.010
_TOUCHED_S = 0.15
_SWING_RAD = 0.6
_SWUNG_RAD = 0.25
_TIMEOUT_S = 7.0
_STALL_S = 1.0
_STALL_PROGRESS_M = 0.001
_TRY_M = 0.02  # Rise of a gripper until it has felt that its load is too heavy.
_GRASP_LEAST_M = 0.015
"""Opening below which the fingers hold no object: all objects are wider."""
_OPEN_M = FINGER_OPENING_M - 0.005
_HELD_UP_M = 0.05
"""Lag of the gripper behind its target that indicates contact with an obstacle."""
_FINGERS_STILL_M = 2e-5
_FINGERS_STILL_S = 0.05
_SETTLE_S = 0.15
_TICKS = round(_TIMEOUT_S / TICK_S)


class Moves:
    """Motions of one arm."""

    def __init__(self, arm: ArmMotion) -> None:
        """Move the given arm."""
        self.arm = arm
        self.scene = arm.scene
        self._name = arm.robot.name

    def check_reach(self, stand: Stand, what: str) -> None:
        """Raise ``UNREACHABLE`` if the arm cannot reach a stand.

        Args:
            stand: The pose of the gripper.
            what: Its role in the explanation, such as ``"pick"``.
        """
        if self.arm.solve_posture(top_down(*stand)) is None:
            raise SkillFailure(
                Outcome.UNREACHABLE,
                f"{self._name} ({self.arm.robot.arm.name}) cannot reach the "
                f"{what} position ({stand[0]:.3f}, {stand[1]:.3f}) at height "
                f"{stand[2]:.2f} m.",
            )

    def grasp(self, over: Stand, low: Stand) -> Motion:
        """Approach ``over``, go straight down to ``low``, and close the fingers."""
        self.arm.opening_m = FINGER_OPENING_M
        yield from self.to(over, fly_by=True)
        yield from self.lower(low)
        self.arm.opening_m = 0.0
        yield from self.wait_for_fingers()
        if self.scene.opening_m(self.arm.robot) < _GRASP_LEAST_M:
            raise SkillFailure(
                Outcome.MISSED_GRASP, f"The fingers of {self._name} closed on nothing."
            )
        yield from self._feel_weight(low)

    def _feel_weight(self, low: Stand) -> Motion:
        """Raise ``OVERLOAD`` if the grasped object is too heavy, after a lift."""
        robot, spec = self.arm.robot.placement, self.scene.spec
        held = self.scene.held().get(self._name)
        if held and (why := robot.overload(self._name, spec.placement(held))):
            yield from self.rise(low, low[2] + _TRY_M)
            raise SkillFailure(Outcome.OVERLOAD, why)

    def release(self, stand: Stand) -> Motion:
        """Open the fingers and rise."""
        self.arm.opening_m = FINGER_OPENING_M
        yield from self.wait_for_fingers()
        yield from self.rise(stand, stand[2] + RETREAT_M)

    def wait_for_fingers(self) -> Motion:
        """Wait until the fingers do not move, at most 1 s."""
        last = self.scene.opening_m(self.arm.robot)
        still = 0.0
        for _ in range(100):
            yield
            now = self.scene.opening_m(self.arm.robot)
            still = still + TICK_S if abs(now - last) < _FINGERS_STILL_M else 0.0
            last = now
            if still >= _FINGERS_STILL_S:
                break

    def check_held(self) -> None:
        """Raise ``DROPPED`` if no object is between the fingers."""
        if self.scene.opening_m(self.arm.robot) < _GRASP_LEAST_M:
            raise SkillFailure(Outcome.DROPPED, f"What {self._name} held slipped away.")

    def to(
        self, stand: Stand, *, fly_by: bool = False, contact: bool = False
    ) -> Motion:
        """Go to a waypoint (x, y, z, yaw) with the gripper pointing down.

        Args:
            stand: The waypoint.
            fly_by: Pass within :data:`FLY_BY_M` without slowing down.
            contact: Put the held object down: the tolerance is 1 mm, and early contact
                with the support also ends the motion with success.
        """
        x, y, z, _ = stand
        pose = top_down(*stand)
        posture = self.arm.solve_posture(pose)
        if posture is None:
            raise SkillFailure(
                Outcome.UNREACHABLE,
                f"{self._name} cannot reach ({x:.3f}, {y:.3f}, {z:.3f}).",
            )
        if fly_by and abs(posture[0] - self.arm.state[0, 0]) > _SWING_RAD:
            yield from self.swing(posture)
        self.arm.aim(pose, posture)
        limit = (FLY_BY_M, _FLY_BY_RAD) if fly_by else (_ARRIVED_M, _ARRIVED_RAD)
        if contact:
            limit = (_LAID_M, _ARRIVED_RAD)
        best, since = math.inf, 0.0
        for _ in range(_TICKS):
            distance, angle = self.arm.error(pose)
            if distance < limit[0] and angle < limit[1]:
                return
            self.check_tracking()
            error = distance + 0.1 * angle
            since = 0.0 if error < best - _STALL_PROGRESS_M else since + TICK_S
            best = min(best, error)
            if contact and since > _TOUCHED_S and distance < _TOUCHED_M:
                return
            if since > _STALL_S:
                yield from self.fall_back(pose)
                return
            yield
        raise SkillFailure(
            Outcome.TIMEOUT, f"{self._name} did not reach a waypoint in time."
        )

    def swing(self, posture: FloatArray) -> Motion:
        """Turn the base towards a far waypoint first, along a line in joint space.

        A straight line in task space may pass over the arm's own base, where the arm
        would have to fold. In joint space the gripper keeps pointing down.
        """
        self.arm.follow_posture(posture)
        for _ in range(_TICKS):
            if largest_turn(posture, self.arm.state[0]) < _SWUNG_RAD:
                return
            self.check_tracking()
            yield
        raise SkillFailure(
            Outcome.TIMEOUT, f"{self._name} could not swing round in time."
        )

    def along(self, start: Stand, end: Stand, speed_m_s: float) -> Motion:
        """Move the target along a straight line; the tool follows closely behind.

        With a fixed target, RMPflow takes a curved path. A straight one is needed close
        to objects, and to push a cube.
        """
        length = math.dist(start[:3], end[:3])
        ticks = max(1, round(length / speed_m_s / TICK_S))
        x, y, z, yaw = start
        dx, dy, dz, turn = end[0] - x, end[1] - y, end[2] - z, wrap(end[3] - yaw)
        posture = self.arm.solve_posture(top_down(*end))
        for i in range(1, ticks + 1):
            t = i / ticks
            self.arm.aim_down(
                x + t * dx, y + t * dy, z + t * dz, yaw + t * turn, posture
            )
            self.check_tracking()
            yield

    def lower(self, stand: Stand, *, contact: bool = False) -> Motion:
        """Go straight down to a waypoint and stop there."""
        height = float(self.arm.reference_pose()[2, 3])
        above = _at_height(stand, max(height, stand[2]))
        if contact:
            # An object that is put down fast penetrates the support or bounces.
            gently = _at_height(stand, min(above[2], stand[2] + _TOUCHDOWN_M))
            yield from self.along(above, gently, _VERTICAL_M_S)
            above = gently
        speed = _TOUCHDOWN_M_S if contact else _VERTICAL_M_S
        yield from self.along(above, stand, speed)
        yield from self.to(stand, contact=contact)

    def rise(self, stand: Stand, height_m: float) -> Motion:
        """Go straight up from a waypoint, without stopping at the end."""
        above = _at_height(stand, height_m)
        yield from self.along(stand, above, _VERTICAL_M_S)

    def fall_back(self, pose: FloatArray) -> Motion:
        """Follow a collision-checked joint path to a pose instead of RMPflow."""
        path = joint_path(self.arm, pose, self.arm.obstacles)
        if path is None:
            raise SkillFailure(
                Outcome.COLLISION,
                f"{self._name} is blocked on its way to "
                f"({pose[0, 3]:.3f}, {pose[1, 3]:.3f}, {pose[2, 3]:.3f}).",
            )
        yield from self.follow(path)

    def follow(self, path: FloatArray) -> Motion:
        """Move the reference along a joint path, (n, 6) [rad], one row per tick."""
        for i in range(len(path)):
            self.arm.state[0] = path[i]
            self.arm.state[1] = 0.0
            self.arm.hold()
            self.check_tracking()
            yield
        for _ in range(round(_SETTLE_S / TICK_S)):
            yield

    def check_tracking(self) -> None:
        """Raise ``COLLISION`` if a joint lags more than its servo should."""
        if self.arm.is_held_up():
            raise SkillFailure(
                Outcome.COLLISION, f"{self._name} was stopped by something."
            )

    def is_full(self) -> bool:
        """Return whether the fingers are neither closed nor open: they may hold."""
        return _GRASP_LEAST_M <= self.scene.opening_m(self.arm.robot) < _OPEN_M

    def give_up(self) -> Motion:
        """Put the held object down here, and rise, so that parking is safe."""
        self.arm.sync()
        self.arm.hold()
        holds = self.is_full()
        if holds:
            yield from self._straight(GRASP_HEIGHT_M, _TOUCHDOWN_M_S)
        self.arm.opening_m = FINGER_OPENING_M
        yield from self.wait_for_fingers()
        if holds:
            yield from self._straight(
                float(self.arm.tcp_pose()[2, 3]) + RETREAT_M, _VERTICAL_M_S
            )
        yield from self.rise_from_here(TRAVEL_HEIGHT_M)

    def rise_from_here(self, height_m: float) -> Motion:
        """Raise the gripper to a height [m] in its present orientation, 1 s at most."""
        pose = self.arm.tcp_pose()
        pose[2, 3] = max(pose[2, 3], height_m)
        self.arm.aim(pose)
        for _ in range(100):
            if abs(self.arm.tcp_pose()[2, 3] - pose[2, 3]) < FLY_BY_M:
                break
            yield

    def _straight(self, height_m: float, speed_m_s: float) -> Motion:
        """Move the gripper straight down or up; stop at contact."""
        pose = self.arm.tcp_pose()
        x, y, z = (float(pose[i, 3]) for i in range(3))
        yaw = math.atan2(pose[1, 0], pose[0, 0])
        posture = self.arm.solve_posture(top_down(x, y, height_m, yaw))
        step = math.copysign(speed_m_s * TICK_S, height_m - z)
        for _ in range(math.ceil(abs((height_m - z) / step))):
            if posture is None or abs(self.arm.tcp_pose()[2, 3] - z) > _HELD_UP_M:
                break
            z += step
            self.arm.aim_down(x, y, z, yaw, posture)
            yield

    def park(self) -> Motion:
        """Go to the park posture."""
        self.arm.opening_m = FINGER_OPENING_M
        park = self.arm.park
        self.arm.follow_posture(park)
        for _ in range(_TICKS):
            if largest_turn(self.arm.measured, park) < _PARKED_RAD:
                break
            yield
        self.arm.follow_posture(park)


def between(start: Stand, end: Stand, distance_m: float) -> Stand:
    """Return the waypoint at a distance [m] along the line from start to end."""
    t = min(1.0, distance_m / max(math.dist(start[:3], end[:3]), 1e-9))
    x, y, z, yaw = (a + t * (b - a) for a, b in zip(start, end, strict=True))
    return (x, y, z, yaw)


def _at_height(stand: Stand, z: float) -> Stand:
    return (stand[0], stand[1], z, stand[3])


_CLEARANCE_M = 0.01
_SLACK_M = 1e-4
_SPEED_FRACTION = 0.4
"""Fraction of the joints' velocity limits on lines in joint space, which may move the
gripper far."""
_CHECK_RAD = 0.05


def joint_path(
    arm: ArmMotion, pose: FloatArray, obstacles: FloatArray
) -> FloatArray | None:
    """Find a joint path from the reference to a gripper pose.

    All branches of inverse kinematics are tried, nearest first, directly and through
    the park posture.

    Args:
        arm: The arm.
        pose: World from gripper at the tool centre point, (4, 4) [m].
        obstacles: Capsules, (n, 7) or wider [m].

    Returns:
        Joint configurations one servo tick apart, (n, 6) [rad], or None.
    """
    start = arm.state[0].copy()
    goals = []
    for q in gripper_ik(arm.robot.arm.name, arm.robot.world_from_base, pose):
        nearest_turn(q, start, arm.joint_range)
        goals.append(q)
    goals.sort(key=lambda q: float(np.abs(q - start).max()))
    for via in ((), (arm.park,)):
        for goal in goals:
            corners = [start, *via, goal]
            legs = list(pairwise(corners))
            if all(_is_free(arm, a, b, obstacles) for a, b in legs):
                return np.concatenate([_time(arm, a, b) for a, b in legs])
    return None


def _is_free(
    arm: ArmMotion, start: FloatArray, end: FloatArray, obstacles: FloatArray
) -> bool:
    """Return whether the arm keeps its clearance along a line in joint space.

    The required clearance is no larger than at the start: an arm that stalled near an
    obstacle may leave, but must not come closer.
    """
    span = float(np.abs(end - start).max())
    steps = max(2, math.ceil(span / _CHECK_RAD))
    before = min(_CLEARANCE_M, _clearance(arm, start, obstacles))
    for i in range(1, steps + 1):
        now = _clearance(arm, start + (i / steps) * (end - start), obstacles)
        if now < before - _SLACK_M:
            return False
        before = min(_CLEARANCE_M, max(before, now))
    return True


def _clearance(arm: ArmMotion, q: FloatArray, obstacles: FloatArray) -> float:
    """Return the smallest gap of an arm to itself, the table and the obstacles [m]."""
    capsules = arm.capsules(q)
    least = min(self_clearance(capsules) + _CLEARANCE_M, table_clearance(capsules))
    if len(obstacles):
        least = min(least, obstacle_clearance(capsules, obstacles))
    return least


def _time(arm: ArmMotion, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return a smooth motion along a line, (n, 6) [rad], at rest at both ends."""
    limits = _SPEED_FRACTION * np.array(arm.robot.arm.velocity_limits)
    # The peak speed of a cubic profile is 1.5 times its mean speed.
    duration = 1.5 * float((np.abs(end - start) / limits).max())
    ticks = max(2, math.ceil(duration / TICK_S))
    t = np.arange(1, ticks + 1) / ticks
    ease = t * t * (3.0 - 2.0 * t)
    return start + ease[:, None] * (end - start)
