"""Motion of one arm: RMPflow advances a joint reference that the servos follow."""

import math
from functools import lru_cache

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.leaves import Leaves
from lemma.motion.rmpflow.policy import integrate
from lemma.motion.rmpflow.workspace import ArmModel, ArmTarget, Workspace
from lemma.robots.collision_model import envelope_of, place_capsules
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.reach import gripper_ik, ik_constants, reach_of, usable_postures
from lemma.robots.ur.build import ARMS
from lemma.robots.ur.kinematics import frames, top_down
from lemma.scene.build import TIME_STEP_S
from lemma.scene.scene import RobotIndex, Scene

SUBSTEP_S = 0.0025
"""Integration step of RMPflow; short, because the stiffest leaves damp at 300/s."""
SUBSTEPS = round(TIME_STEP_S / SUBSTEP_S)

_PARK_BEARING_RAD = math.radians(115.0)
_PARK_HEIGHTS_M = (0.42, 0.36, 0.30, 0.24)
"""Heights of the park posture to try in this order: small arms need a lower one."""
_BRANCH_COST = 100.0
_TRACKING_LIMIT_RAD = 0.12
POSTURE_ALONE = 20.0
"""Weight of the posture leaf when there is no target pose."""
_NOWHERE = np.eye(4)


@lru_cache
def park_joints(arm_name: str) -> tuple[float, ...]:
    """Return the park posture, (6,) [rad]: folded beside the base, out of camera view.

    The gripper points down, left of the robot and slightly behind it; from there, the
    base turns the arm over the table without a change of kinematic branch.
    """
    reach = reach_of(arm_name)
    radius = max(0.42 * reach.travel_m, reach.inner_m + 0.02)
    for height in _PARK_HEIGHTS_M:
        pose = top_down(
            radius * math.cos(_PARK_BEARING_RAD),
            radius * math.sin(_PARK_BEARING_RAD),
            height,
            _PARK_BEARING_RAD,
        )
        solutions = gripper_ik(arm_name, np.eye(4), pose)
        # Of the solutions with the elbow up, the one with the smallest base turn.
        dh = ARMS[arm_name].dh
        elbow_up = [q for q in solutions if _elbow_height(dh, q) > 0.0]
        if elbow_up:
            return tuple(min(elbow_up, key=lambda q: abs(q[0]) + abs(q[3])).tolist())
    raise InvalidConfigError(
        f"Arm {arm_name!r} has no posture to wait in: it cannot hold its gripper down "
        f"beside its base at any height in {_PARK_HEIGHTS_M} m. Check its numbers."
    )


@kernel
def _elbow_height(dh: FloatArray, q: FloatArray) -> float:
    """Return the height of the elbow above the midpoint of shoulder and wrist [m]."""
    placed = np.empty((7, 4, 4))
    frames(dh, np.eye(4), q, placed)
    height: float = placed[2, 2, 3] - 0.5 * (placed[1, 2, 3] + placed[3, 2, 3])
    return height


@kernel
def _branch(dh: FloatArray, q: FloatArray) -> tuple[bool, bool, bool]:
    """Return the kinematic branch: elbow up, shoulder towards wrist, wrist positive."""
    placed = np.empty((7, 4, 4))
    frames(dh, np.eye(4), q, placed)
    # Positive if the shoulder faces the wrist.
    front = placed[1, 0, 0] * placed[4, 0, 3] + placed[1, 1, 0] * placed[4, 1, 3]
    return _elbow_height(dh, q) > 0.0, front > 0.0, math.sin(q[4]) > 0.0


@kernel
def nearest_turn(angles: FloatArray, reference: FloatArray, limit: FloatArray) -> None:
    """Add whole turns to ``angles`` (6,) [rad] to bring them near ``reference``."""
    for i in range(6):
        turns = round((reference[i] - angles[i]) / math.tau)
        turned = angles[i] + turns * math.tau
        if abs(turned) > limit[i]:
            turned = angles[i]
        angles[i] = turned


@kernel
def _nearest(
    dh: FloatArray,
    solutions: FloatArray,
    reference: FloatArray,
    limit: FloatArray,
    branch: tuple[bool, bool, bool],
) -> int:
    """Add whole turns to solutions, (n, 6) [rad]; return the index nearest a reference.

    Solutions of other branches get a penalty. The index is -1 if there is no solution.
    """
    best, best_cost = -1, math.inf
    for s in range(solutions.shape[0]):
        q, cost = solutions[s], 0.0
        nearest_turn(q, reference, limit)
        for i in range(6):
            cost = max(cost, abs(q[i] - reference[i]))
        if _branch(dh, q) != branch:
            cost += _BRANCH_COST
        if cost < best_cost:
            best, best_cost = s, cost
    return best


@kernel
def choose_posture(  # noqa: PLR0913 - all that the choice depends on
    dh: FloatArray,
    base: FloatArray,
    links: FloatArray,
    capsules: FloatArray,
    limit: FloatArray,
    park: FloatArray,
    reference: FloatArray,
    pose: FloatArray,
    out: FloatArray,
) -> bool:
    """Write the joint angles that :meth:`ArmMotion.solve_posture` returns to ``out``.

    Args:
        dh: Denavit-Hartenberg lengths of the arm, (6,) [m].
        base: World from base, (4, 4) [m].
        links: Link frame of each capsule of the arm, (n,).
        capsules: Both ends and radius in link frames, (n, 7) [m].
        limit: Largest absolute angles, (6,) [rad].
        park: Park posture, (6,) [rad].
        reference: Present joint angles, (6,) [rad].
        pose: World from gripper at the tool centre point, (4, 4) [m].
        out: Written, (6,) [rad]; unchanged if there is no solution.

    Returns:
        Whether there is a solution.
    """
    found = usable_postures(dh, base, pose, limit, links, capsules)
    best = _nearest(dh, found, reference, limit, _branch(dh, park))
    if best >= 0:
        out[:] = found[best]
    return best >= 0


@kernel
def _lead_servos(  # noqa: PLR0913 - one call is what makes it fast
    record: np.ndarray,
    spheres: FloatArray,
    state: FloatArray,
    obstacles: FloatArray,
    lag_s: float,
    opening_m: float,
    pace: float,
    servos: int,
    gripper: int,
    out: FloatArray,
) -> None:
    """Advance the reference by one physics step per row of ``out``, (n, nu) [rad, m].

    Writes the six columns from ``servos`` on, which are the reference extrapolated by
    the servos' lag, and the column of the gripper.
    """
    for step in range(out.shape[0]):
        integrate(record, spheres, state, obstacles, pace * SUBSTEP_S, SUBSTEPS)
        for i in range(6):
            out[step, servos + i] = state[0, i] + pace * lag_s * state[1, i]
        out[step, gripper] = opening_m


@kernel
def _set_goal(
    record: np.ndarray, pose: FloatArray, posture: FloatArray, weight: float
) -> None:
    """Set a pose of the tool centre point, (4, 4), and a posture, (6,), as goal."""
    goal = record[0].goal
    for i in range(3):
        goal.position[i] = pose[i, 3]
        for j in range(3):
            goal.rotation[i, j] = pose[i, j]
    goal.posture[:] = posture
    goal.target_weight = weight
    goal.posture_weight = 1.0 if weight > 0.0 else POSTURE_ALONE


@kernel
def _aim_down(
    record: np.ndarray, x: float, y: float, z: float, yaw: float, posture: FloatArray
) -> None:
    """Set a gripper that points down (see :func:`top_down`) and a posture as goal."""
    _set_goal(record, top_down(x, y, z, yaw), posture, 1.0)


@kernel
def _tcp(dh: FloatArray, base: FloatArray, q: FloatArray) -> FloatArray:
    """Return world from gripper at the tool centre point, (4, 4)."""
    placed = np.empty((7, 4, 4))
    frames(dh, base, q, placed)
    pose: FloatArray = placed[6]
    for i in range(3):
        pose[i, 3] += TCP_OFFSET_M * pose[i, 2]
    return pose


@kernel
def _pose_error(
    dh: FloatArray, base: FloatArray, q: FloatArray, goal: FloatArray
) -> tuple[float, float]:
    """Return distance [m] and largest angle between axes [rad] from a goal, (4, 4)."""
    pose = _tcp(dh, base, q)
    squares, trace = 0.0, 0.0
    for i in range(3):
        squares += (pose[i, 3] - goal[i, 3]) ** 2
        for j in range(3):
            trace += pose[i, j] * goal[i, j]
    return math.sqrt(squares), math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@kernel
def _is_held_up(q: FloatArray, state: FloatArray, lag_s: float) -> bool:
    """Return whether a joint is farther from the reference than servo lag explains."""
    for i in range(6):
        if abs(q[i] - state[0, i]) > _TRACKING_LIMIT_RAD + lag_s * abs(state[1, i]):
            return True
    return False


@kernel
def largest_turn(a: FloatArray, b: FloatArray) -> float:
    """Return the largest absolute difference between two postures, (6,) [rad]."""
    largest = 0.0
    for i in range(6):
        largest = max(largest, abs(a[i] - b[i]))
    return largest


class ArmMotion:
    """The joint reference of one arm, advanced in step with the physics."""

    def __init__(self, scene: Scene, robot: RobotIndex) -> None:
        """Start at the arm's present joint angles, at rest.

        Args:
            scene: The compiled scene.
            robot: The arm to move.
        """
        self.scene = scene
        self.robot = robot
        self._dh = robot.arm.dh
        self._base = robot.world_from_base
        self._lag_s = robot.arm.lag_s
        self._servos, self._gripper = robot.ctrl.start, robot.gripper_ctrl
        self.measured: FloatArray = scene.data.qpos[robot.qpos]
        """Simulated joint angles, (6,) [rad]: a view of ``qpos``."""
        envelope = envelope_of(robot.arm.name)
        self.joint_range = limits = np.array(robot.arm.joint_range)
        model = ArmModel(
            dh=self._dh,
            world_from_base=robot.world_from_base,
            tcp_offset_m=TCP_OFFSET_M,
            lower=-limits,
            upper=limits,
            velocity_limits=np.array(robot.arm.velocity_limits),
            sphere_links=envelope.sphere_links,
            spheres=envelope.spheres,
            sphere_meets_table=envelope.sphere_meets_table,
            base_radius_m=robot.arm.shoulder_radius,
        )
        self.state: FloatArray = np.zeros((2, 6))
        self.opening_m = FINGER_OPENING_M
        self.pace = 1.0
        """Speed of the reference: 0.5 is half of the usual speed."""
        self.park = np.array(park_joints(robot.arm.name))
        goal = ArmTarget(np.zeros(3), np.eye(3), self.park, 0.0, 1.0)
        self.workspace = Workspace()
        """The memory of RMPflow."""
        self.workspace.load(model, goal, Leaves())
        self.obstacles = np.zeros((0, 8))
        self.sync()

    def sync(self) -> None:
        """Set the reference to the measured joint angles, at rest."""
        self.state[0] = self.measured
        self.state[1] = 0.0

    def hold(self) -> None:
        """Set the reference's present posture as goal."""
        goal = self.workspace.record[0]["goal"]
        goal["posture"], goal["target_weight"] = self.state[0], 0.0

    def set_obstacles(self, obstacles: FloatArray) -> None:
        """Set the obstacles: both ends, radius and range of capsules, (n, 8) [m]."""
        self.obstacles = np.ascontiguousarray(obstacles)

    def solve_posture(self, pose: FloatArray) -> FloatArray | None:
        """Return the joint angles nearest to the reference that reach a gripper pose.

        The kinematic branch of the park posture is preferred: a change of branch on the
        way sweeps the arm through objects and through itself.

        Args:
            pose: World from gripper at the tool centre point, (4, 4) [m].

        Returns:
            (6,) [rad], or None if there is no solution.
        """
        dh, limit, links, capsules = ik_constants(self.robot.arm.name)
        base, posture = self.robot.world_from_base, np.empty(6)
        found = choose_posture(
            *(dh, base, links, capsules, limit),
            *(self.park, self.state[0], pose, posture),
        )
        return posture if found else None

    def aim(self, pose: FloatArray, posture: FloatArray | None = None) -> None:
        """Set the target, world from gripper at the tool centre point, (4, 4) [m]."""
        if posture is None:
            posture = self.state[0]
        _set_goal(self.workspace.record, pose, posture, 1.0)

    def aim_down(
        self, x: float, y: float, z: float, yaw: float, posture: FloatArray | None
    ) -> None:
        """Set as target a gripper that points down at x, y, z [m], with yaw [rad]."""
        if posture is None:
            posture = self.state[0]
        _aim_down(self.workspace.record, x, y, z, yaw, posture)

    def follow_posture(self, posture: FloatArray) -> None:
        """Set joint angles, (6,) [rad], as the only goal."""
        _set_goal(self.workspace.record, _NOWHERE, posture, 0.0)

    def lead(self, commands: FloatArray) -> None:
        """Advance the reference by some physics steps.

        Args:
            commands: Commands of all servos before each of n steps, (n, nu)
                [rad, m]; the columns of this arm are written.
        """
        space = self.workspace
        _lead_servos(
            space.record,
            space.spheres,
            self.state,
            self.obstacles,
            self._lag_s,
            *(self.opening_m, self.pace),
            self._servos,
            self._gripper,
            commands,
        )

    def tcp_pose(self) -> FloatArray:
        """Return the measured world from gripper at the tool centre point, (4, 4)."""
        return _tcp(self._dh, self._base, self.measured)

    def reference_pose(self) -> FloatArray:
        """Return world from gripper at the reference's tool centre point, (4, 4)."""
        return _tcp(self._dh, self._base, self.state[0])

    def aim_pose(self) -> FloatArray:
        """Return the target, world from gripper at the tool centre point, (4, 4) [m].

        If the goal is a posture, it is the pose at that posture.
        """
        goal = self.workspace.record[0]["goal"]
        if goal["target_weight"] <= 0.0:
            return _tcp(self._dh, self._base, goal["posture"].copy())
        pose: FloatArray = np.eye(4)
        pose[:3, :3], pose[:3, 3] = goal["rotation"], goal["position"]
        return pose

    def error(self, pose: FloatArray) -> tuple[float, float]:
        """Return the error of the measured tool centre point from a pose, (4, 4) [m].

        Returns:
            Distance [m] and largest angle between the axes [rad].
        """
        return _pose_error(self._dh, self._base, self.measured, pose)

    def is_held_up(self) -> bool:
        """Return whether a joint lags more than its servo should: it is blocked."""
        return _is_held_up(self.measured, self.state, self._lag_s)

    def capsules(self, q: FloatArray | None = None) -> FloatArray:
        """Return the arm's capsules in the world at ``q`` or now, (n, 7) [m]."""
        envelope, placed = envelope_of(self.robot.arm.name), np.empty((7, 4, 4))
        at = self.measured if q is None else q
        frames(self._dh, self.robot.world_from_base, at, placed)
        out = np.empty((len(envelope.capsules), 7))
        place_capsules(placed, envelope.capsule_links, envelope.capsules, out)
        return out
