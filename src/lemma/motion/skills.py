"""Primitives as motions: waypoints for RMPflow, the gripper, and what can go wrong.

A skill is a generator: it sets goals and looks at the world, and hands control back once
a servo tick, so that the one step loop (in ``env``) stays the one step loop. It ends with
every robot parked and nothing held, whatever happened.
"""

import math
from collections.abc import Generator
from dataclasses import replace

import mujoco
import numpy as np

from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.motion.arm import ArmMotion
from lemma.motion.obstacles import around
from lemma.motion.outcome import Outcome, SkillFailure, SkillResult
from lemma.motion.paths import joint_path
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.kinematics import top_down
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.scene.objects import height_m
from lemma.scene.spec import STICK
from lemma.tasks.subtask import GroundedSubTask, Primitive

Skill = Generator[None, None, SkillResult]
Motion = Generator[None, None, None]
Stand = tuple[float, float, float, float]
"""Where a gripper that points down stands: x, y, z [m] and yaw [rad]."""

STICK_GRASP_HEIGHT_M = 0.018
"""The fingertips end 6 mm above the table, so they never touch it."""
DRAG_HEIGHT_M = 0.022
"""While it pushes or pulls, the stick hovers 4 mm above the table."""
DRAG_SPEED_M_S = 0.2
_VERTICAL_M_S = 0.5
_TOUCHDOWN_M = 0.03
_TOUCHDOWN_M_S = 0.12
_MEETING_M = 0.05
_MEETING_M_S = 0.1
"""The stick meets the cube slowly: a knock would send it ahead."""
RETREAT_M = 0.13
"""How far the gripper rises before the arm swings away."""

_PRESS_M = 0.0005
"""What is put down is lowered until it surely touches: nothing is dropped."""
_FLY_BY_M = 0.03
_FLY_BY_RAD = 0.15
_ARRIVED_M = 0.002
_ARRIVED_RAD = 0.02
_PARKED_RAD = 0.05
_TOUCHED_M = 0.010
_TOUCHED_S = 0.15
_SWING_RAD = 0.6
_SWUNG_RAD = 0.25
_WAYPOINT_TIMEOUT_S = 7.0
_STALL_S = 1.0
_STALL_PROGRESS_M = 0.001
_TRACKING_LIMIT_RAD = 0.12
_GRASP_LEAST_M = 0.015
"""Narrower than this the fingers hold nothing that exists here."""
_SETTLE_S = 0.15
_TICK_S = 0.01
_WITHDRAW_M = 0.03


class SkillRunner:
    """Executes grounded sub-tasks with the arms of one scene."""

    def __init__(self, arms: dict[str, ArmMotion]) -> None:
        """Keep the arms.

        Args:
            arms: Motion of every robot of the scene, by robot name.
        """
        self.arms = arms
        self.scene = next(iter(arms.values())).scene

    def run(self, subtask: GroundedSubTask) -> Skill:
        """Execute a sub-task; yields once per servo tick, returns how it went.

        Afterwards the arm is parked and its gripper open, also after a failure.
        """
        start = self.scene.time_s
        arm = self.arms[subtask.robot]
        result = SkillResult(Outcome.SUCCESS, "Done.", 0.0)
        try:
            if subtask.primitive in (Primitive.HOOK, Primitive.POKE):
                yield from self._drag(arm, subtask)
            else:
                yield from self._move(arm, subtask)
        except SkillFailure as failure:
            result = SkillResult(failure.outcome, failure.explanation, 0.0)
            yield from self._give_up(arm)
        yield from self._park(arm)
        return SkillResult(
            result.outcome, result.explanation, self.scene.time_s - start
        )

    def _move(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        held, grip_m = self._what_to_pick(subtask)
        subtask = _as_it_turns(subtask, arm)
        low = _stand(subtask.pick, grip_m)
        over = _stand(subtask.pick, max(grip_m, TRAVEL_HEIGHT_M))
        body = self.scene.model.body(held).id
        bottom = grip_m - _grip_above_bottom(held)
        support = self.surface(subtask.place, exclude=body)[0]
        put = _stand(subtask.place, support + grip_m - bottom - _PRESS_M)
        over_put = _stand(subtask.place, max(put[2], TRAVEL_HEIGHT_M))
        for pose in (low, over):
            self._check_reach(arm, pose, "pick")
        for pose in (put, over_put):
            self._check_reach(arm, pose, "place")
        arm.set_obstacles(around(self.arms, arm, subtask.pick, held))
        yield from self._grasp(arm, over, low)
        yield from self._rise(arm, low, over[2] - _FLY_BY_M)
        self._check_held(arm)
        arm.set_obstacles(around(self.arms, arm, subtask.place, held))
        yield from self._to(arm, over_put, fly_by=True)
        self._check_held(arm)
        yield from self._lower(arm, put, contact=True)
        yield from self._release(arm, put)

    def _drag(self, arm: ArmMotion, subtask: GroundedSubTask) -> Motion:
        held, _ = self._what_to_pick(subtask)
        if held != STICK:
            raise SkillFailure(
                Outcome.INVALID,
                f"{subtask.primitive} needs the stick, but the pick pose is on {held}.",
            )
        subtask = _as_it_turns(subtask, arm)
        low = _stand(subtask.pick, STICK_GRASP_HEIGHT_M)
        over = _stand(subtask.pick, TRAVEL_HEIGHT_M)
        start = _stand(subtask.pick, DRAG_HEIGHT_M)
        end = _stand(subtask.place, DRAG_HEIGHT_M)
        for pose in (low, over):
            self._check_reach(arm, pose, "pick")
        self._check_reach(arm, end, "place")
        arm.set_obstacles(around(self.arms, arm, subtask.pick, held))
        yield from self._grasp(arm, over, low)
        yield from self._to(arm, start, contact=True)
        self._check_held(arm)
        met = _between(start, end, _MEETING_M)
        yield from self._along(arm, start, met, _MEETING_M_S)
        yield from self._along(arm, met, end, DRAG_SPEED_M_S)
        yield from self._to(arm, end, contact=True)
        self._check_held(arm)
        last = end
        for stand in _withdrawal(subtask.primitive, start, end):
            if arm.solve_posture(top_down(*stand)) is not None:
                yield from self._to(arm, stand, contact=True)
                last = stand
        down = (last[0], last[1], STICK_GRASP_HEIGHT_M - _PRESS_M, last[3])
        yield from self._to(arm, down, contact=True)
        yield from self._release(arm, down)

    def _what_to_pick(self, subtask: GroundedSubTask) -> tuple[str, float]:
        """Return what lies under the pick pose and the height to grasp it at [m]."""
        top, entity = self.surface(subtask.pick)
        if entity is None or entity not in self.scene.movable_names:
            found = entity or "the bare table"
            raise SkillFailure(
                Outcome.NOTHING_TO_PICK,
                f"Nothing to pick at ({subtask.pick.x:.3f}, {subtask.pick.y:.3f}): "
                f"{found} is there.",
            )
        needs_stick = subtask.primitive is not Primitive.MOVE
        if needs_stick and entity != STICK:
            raise SkillFailure(
                Outcome.INVALID,
                f"{subtask.primitive} needs the stick, but {entity} is at the pick "
                "pose.",
            )
        kind = self.scene.spec.placement(entity).kind
        return entity, top - height_m(kind) + _grip_above_bottom(entity)

    def surface(self, pose: Pose2, exclude: int = -1) -> tuple[float, str | None]:
        """Return what a depth camera above would see at a table position.

        Args:
            pose: Where.
            exclude: MuJoCo body to look through.

        Returns:
            Height of the highest surface [m] and the entity it belongs to, None for the
            table. Robots are looked through.
        """
        groups = np.array([1, 1, 0, 0, 0, 0], dtype=np.uint8)
        geom = np.array([-1], dtype=np.int32)
        start_z = 1.0
        self.scene.refresh()
        distance = mujoco.mj_ray(
            self.scene.model,
            self.scene.data,
            np.array([pose.x, pose.y, start_z]),
            np.array([0.0, 0.0, -1.0]),
            groups,
            1,
            exclude,
            geom,
        )
        if distance < 0:
            return 0.0, None
        body = int(self.scene.model.geom_bodyid[geom[0]])
        return max(0.0, start_z - distance), self.scene.entity_of_body(body)

    def _check_reach(self, arm: ArmMotion, stand: Stand, what: str) -> None:
        if arm.solve_posture(top_down(*stand)) is None:
            raise SkillFailure(
                Outcome.UNREACHABLE,
                f"{arm.robot.name} ({arm.robot.arm.name}) cannot reach the {what} "
                f"position ({stand[0]:.3f}, {stand[1]:.3f}) at height {stand[2]:.2f} m.",
            )

    def _grasp(
        self,
        arm: ArmMotion,
        over: Stand,
        low: Stand,
    ) -> Motion:
        arm.opening_m = FINGER_OPENING_M
        yield from self._to(arm, over, fly_by=True)
        yield from self._lower(arm, low)
        arm.opening_m = 0.0
        yield from self._wait_for_fingers(arm)
        if self.scene.opening_m(arm.robot) < _GRASP_LEAST_M:
            raise SkillFailure(Outcome.MISSED_GRASP, "The fingers closed on nothing.")

    def _release(self, arm: ArmMotion, stand: Stand) -> Motion:
        arm.opening_m = FINGER_OPENING_M
        yield from self._wait_for_fingers(arm)
        yield from self._rise(arm, stand, stand[2] + RETREAT_M)

    def _wait_for_fingers(self, arm: ArmMotion) -> Motion:
        """Wait until the fingers stand still, at most a second."""
        last = self.scene.opening_m(arm.robot)
        still = 0.0
        for _ in range(100):
            yield
            now = self.scene.opening_m(arm.robot)
            still = still + _TICK_S if abs(now - last) < 2e-5 else 0.0
            last = now
            if still >= 0.05:
                break

    def _check_held(self, arm: ArmMotion) -> None:
        if self.scene.opening_m(arm.robot) < _GRASP_LEAST_M:
            raise SkillFailure(Outcome.DROPPED, "What was held slipped away.")

    def _to(
        self,
        arm: ArmMotion,
        stand: Stand,
        *,
        fly_by: bool = False,
        contact: bool = False,
    ) -> Motion:
        """Go to a waypoint (x, y, z, yaw) with the gripper pointing down.

        Args:
            arm: Who goes.
            stand: The waypoint.
            fly_by: Near is enough: the arm does not slow down.
            contact: What is held is put down: that it touches the support a little early
                ends the motion well.
        """
        x, y, z, _ = stand
        pose = top_down(*stand)
        posture = arm.solve_posture(pose)
        if posture is None:
            raise SkillFailure(
                Outcome.UNREACHABLE,
                f"{arm.robot.name} cannot reach ({x:.3f}, {y:.3f}, {z:.3f}).",
            )
        if fly_by and abs(posture[0] - arm.state[0, 0]) > _SWING_RAD:
            yield from self._swing(arm, posture)
        arm.aim(pose, posture)
        limit = (_FLY_BY_M, _FLY_BY_RAD) if fly_by else (_ARRIVED_M, _ARRIVED_RAD)
        best, since = math.inf, 0.0
        for _ in range(round(_WAYPOINT_TIMEOUT_S / _TICK_S)):
            distance, angle = _error(arm.tcp_pose(), pose)
            if distance < limit[0] and angle < limit[1]:
                return
            self._check_tracking(arm)
            error = distance + 0.1 * angle
            since = 0.0 if error < best - _STALL_PROGRESS_M else since + _TICK_S
            best = min(best, error)
            if contact and since > _TOUCHED_S and distance < _TOUCHED_M:
                return
            if since > _STALL_S:
                yield from self._fall_back(arm, pose)
                return
            yield
        raise SkillFailure(Outcome.TIMEOUT, "A waypoint was not reached in time.")

    def _swing(self, arm: ArmMotion, posture: FloatArray) -> Motion:
        """Turn the base towards a far waypoint first.

        A straight line of the tool may pass over the arm's own base, where the arm would
        have to fold; a straight line in joint space keeps the gripper pointing down.
        """
        arm.follow_posture(posture)
        for _ in range(round(_WAYPOINT_TIMEOUT_S / _TICK_S)):
            if float(np.abs(posture - arm.state[0]).max()) < _SWUNG_RAD:
                return
            self._check_tracking(arm)
            yield
        raise SkillFailure(Outcome.TIMEOUT, "The arm could not swing in time.")

    def _along(
        self,
        arm: ArmMotion,
        start: Stand,
        end: Stand,
        speed_m_s: float,
    ) -> Motion:
        """Lead the target along a straight line; the tool follows closely behind.

        Left to itself RMPflow reaches a waypoint on whatever curve suits the joints. Where
        objects stand close, or a cube is being pushed, the way there matters too.
        """
        length = math.dist(start[:3], end[:3])
        ticks = max(1, round(length / speed_m_s / _TICK_S))
        turn = wrap(end[3] - start[3])
        posture = arm.solve_posture(top_down(*end))
        for i in range(1, ticks + 1):
            t = i / ticks
            x, y, z = (a + t * (b - a) for a, b in zip(start[:3], end[:3], strict=True))
            arm.aim(top_down(x, y, z, start[3] + t * turn), posture)
            self._check_tracking(arm)
            yield

    def _lower(self, arm: ArmMotion, stand: Stand, *, contact: bool = False) -> Motion:
        """Go straight down to a waypoint and arrive there."""
        height = float(arm.reference_pose()[2, 3])
        above = _at_height(stand, max(height, stand[2]))
        if contact:
            # What is put down fast sinks in or bounces.
            gently = _at_height(stand, min(above[2], stand[2] + _TOUCHDOWN_M))
            yield from self._along(arm, above, gently, _VERTICAL_M_S)
            above = gently
        speed = _TOUCHDOWN_M_S if contact else _VERTICAL_M_S
        yield from self._along(arm, above, stand, speed)
        yield from self._to(arm, stand, contact=contact)

    def _rise(self, arm: ArmMotion, stand: Stand, height_m: float) -> Motion:
        """Go straight up from a waypoint, without stopping at the end."""
        above = _at_height(stand, height_m)
        yield from self._along(arm, stand, above, _VERTICAL_M_S)

    def _fall_back(self, arm: ArmMotion, pose: FloatArray) -> Motion:
        """Leave RMPflow: a collision-checked joint path from inverse kinematics."""
        path = joint_path(arm, pose, around(self.arms, arm, None, None))
        if path is None:
            raise SkillFailure(
                Outcome.COLLISION,
                f"{arm.robot.name} is blocked on its way to "
                f"({pose[0, 3]:.3f}, {pose[1, 3]:.3f}, {pose[2, 3]:.3f}).",
            )
        yield from self._follow(arm, path)

    def _follow(self, arm: ArmMotion, path: FloatArray) -> Motion:
        """Lead the reference along joint configurations, (n, 6), one per tick."""
        for i in range(len(path)):
            arm.state[0] = path[i]
            arm.state[1] = 0.0
            arm.hold()
            self._check_tracking(arm)
            yield
        for _ in range(round(_SETTLE_S / _TICK_S)):
            yield

    def _check_tracking(self, arm: ArmMotion) -> None:
        lag = arm.scene.data.qpos[arm.robot.qpos] - arm.state[0]
        # A servo follows within its lag; more means that something holds the arm.
        expected = arm.robot.arm.lag_s * np.abs(arm.state[1])
        if bool((np.abs(lag) > _TRACKING_LIMIT_RAD + expected).any()):
            raise SkillFailure(
                Outcome.COLLISION, f"{arm.robot.name} was stopped by something."
            )

    def _give_up(self, arm: ArmMotion) -> Motion:
        """Open the gripper where the arm is and rise, so that parking is safe."""
        arm.sync()
        arm.hold()
        arm.opening_m = FINGER_OPENING_M
        yield from self._wait_for_fingers(arm)
        pose = arm.tcp_pose()
        pose[2, 3] = max(pose[2, 3], TRAVEL_HEIGHT_M)
        arm.aim(pose)
        for _ in range(100):
            if abs(arm.tcp_pose()[2, 3] - pose[2, 3]) < _FLY_BY_M:
                break
            yield

    def _park(self, arm: ArmMotion) -> Motion:
        """Go to where the arm waits."""
        arm.opening_m = FINGER_OPENING_M
        arm.set_obstacles(around(self.arms, arm, None, None))
        park = arm.park
        arm.follow_posture(park)
        for _ in range(round(_WAYPOINT_TIMEOUT_S / _TICK_S)):
            q = arm.scene.data.qpos[arm.robot.qpos]
            if float(np.abs(q - park).max()) < _PARKED_RAD:
                break
            yield
        arm.follow_posture(park)


def _grip_above_bottom(entity: str) -> float:
    """Return how far above its own bottom an object is grasped [m]."""
    return STICK_GRASP_HEIGHT_M if entity == STICK else 0.5 * height_m("cube")


def _stand(pose: Pose2, z: float) -> Stand:
    return (pose.x, pose.y, z, pose.yaw)


def _withdrawal(
    primitive: Primitive,
    start: Stand,
    end: Stand,
) -> list[Stand]:
    """Return waypoints that take the stick off the cube, so that fingers fit around it.

    A hook is pushed out beyond the cube and then to the side of its opening's far end; a
    head is drawn back.
    """
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = max(math.hypot(dx, dy), 1e-9)
    ux, uy = dx / length, dy / length
    back = (end[0] - _WITHDRAW_M * ux, end[1] - _WITHDRAW_M * uy, end[2], end[3])
    if primitive is Primitive.POKE:
        return [back]
    # The drag points from the hook to the hand; the handle is to its left of the cube.
    side = (back[0] - _WITHDRAW_M * uy, back[1] + _WITHDRAW_M * ux, back[2], back[3])
    return [back, side]


def _at_height(stand: Stand, z: float) -> Stand:
    return (stand[0], stand[1], z, stand[3])


def _between(start: Stand, end: Stand, distance_m: float) -> Stand:
    """Return the waypoint that lies a distance along the way."""
    t = min(1.0, distance_m / max(math.dist(start[:3], end[:3]), 1e-9))
    x, y, z, yaw = (a + t * (b - a) for a, b in zip(start, end, strict=True))
    return (x, y, z, yaw)


def _as_it_turns(subtask: GroundedSubTask, arm: ArmMotion) -> GroundedSubTask:
    """Return the sub-task with both yaws half a turn on, where that turns the arm less.

    The fingers are alike, so half a turn does not matter to the grasp; but what is held
    must turn from pick to place as the sub-task says, so both turn or neither.
    """
    gripper = arm.tcp_pose()
    turned = math.pi + subtask.pick.yaw - math.atan2(gripper[1, 0], gripper[0, 0])
    if abs(wrap(turned)) >= 0.5 * math.pi:
        return subtask
    return replace(
        subtask,
        pick=replace(subtask.pick, yaw=subtask.pick.yaw + math.pi),
        place=replace(subtask.place, yaw=subtask.place.yaw + math.pi),
    )


def _error(pose: FloatArray, goal: FloatArray) -> tuple[float, float]:
    """Return distance [m] and largest angle between axes [rad] of two poses."""
    dx, dy, dz = (float(pose[i, 3] - goal[i, 3]) for i in range(3))
    trace = sum(float(pose[i, j] * goal[i, j]) for i in range(3) for j in range(3))
    cosine = min(1.0, max(-1.0, 0.5 * (trace - 1.0)))
    return math.sqrt(dx * dx + dy * dy + dz * dz), math.acos(cosine)
