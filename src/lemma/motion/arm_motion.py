"""One arm under RMPflow: a joint reference that servos follow."""

import math
from functools import lru_cache

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray
from lemma.motion.rmpflow.leaves import Leaves
from lemma.motion.rmpflow.policy import (
    ArmModel,
    ArmTarget,
    Workspace,
    integrate,
    make_root,
)
from lemma.robots.collision_model import envelope_of, place_capsules
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.reach import gripper_ik, ik_constants, reach_of, usable_postures
from lemma.robots.ur.build import ARMS
from lemma.robots.ur.kinematics import frames, top_down
from lemma.scene.build import TIME_STEP_S
from lemma.scene.scene import RobotIndex, Scene

SUBSTEP_S = 0.0025
"""RMPflow's own step: its stiffest leaves brake at 300/s and need it short."""
SUBSTEPS = round(TIME_STEP_S / SUBSTEP_S)

_PARK_BEARING_RAD = math.radians(115.0)
_PARK_HEIGHTS_M = (0.42, 0.36, 0.30, 0.24)
"""The first that an arm can do: a small arm folds lower."""
_BRANCH_COST = 100.0


@lru_cache
def park_joints(arm_name: str) -> tuple[float, ...]:
    """Return where an arm waits: folded, beside its base, out of its camera's view.

    The gripper points down at the robot's left, a little behind it; from there a turn
    of the base takes the whole arm over the table on the same branch of its kinematics.
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
        # The elbow above the line from shoulder to wrist, and the base turned least.
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
    """Return how high the elbow is above the middle of shoulder and wrist [m]."""
    placed = np.empty((7, 4, 4))
    frames(dh, np.eye(4), q, placed)
    height: float = placed[2, 2, 3] - 0.5 * (placed[1, 2, 3] + placed[3, 2, 3])
    return height


@kernel
def _branch(dh: FloatArray, q: FloatArray) -> tuple[bool, bool, bool]:
    """Return which of its eight ways the arm takes: elbow, shoulder, wrist."""
    placed = np.empty((7, 4, 4))
    frames(dh, np.eye(4), q, placed)
    # The shoulder looks at the wrist or away from it.
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
    """Turn solutions, (n, 6), towards a reference; return the nearest, -1 if none is.

    Those of another branch count as far away.
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
        dh: Of the arm, (6,) [m].
        base: World from base, (4, 4).
        links: Link that each capsule of the arm is fixed to, (n,).
        capsules: Ends and radius in the frame of the link, (n, 7) [m].
        limit: Largest angles, (6,) [rad].
        park: Where the arm waits, (6,) [rad].
        reference: Where it is, (6,) [rad].
        pose: World from gripper at the tool centre point, (4, 4).
        out: Written, (6,) [rad]; left alone where the arm cannot be.

    Returns:
        Whether the arm can be there.
    """
    found = usable_postures(dh, base, pose, limit, links, capsules)
    best = _nearest(dh, found, reference, limit, _branch(dh, park))
    if best >= 0:
        out[:] = found[best]
    return best >= 0


class ArmMotion:
    """The reference of one arm, advanced in time with the physics."""

    def __init__(self, scene: Scene, robot: RobotIndex) -> None:
        """Start at the arm's present joint angles, at rest.

        Args:
            scene: The world.
            robot: The arm to move.
        """
        self.scene = scene
        self.robot = robot
        self._dh = robot.arm.dh
        self.leaves = Leaves()
        envelope = envelope_of(robot.arm.name)
        limits = np.array(robot.arm.joint_range)
        self.joint_range = limits
        self._model = ArmModel(
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
        self._root: Workspace = make_root()
        self.state: FloatArray = np.zeros((2, 6))
        self.opening_m = FINGER_OPENING_M
        self.park = np.array(park_joints(robot.arm.name))
        self.goal = self._resting_goal()
        self.obstacles = np.zeros((0, 8))
        self.sync()

    def _resting_goal(self) -> ArmTarget:
        return ArmTarget(np.zeros(3), np.eye(3), self.park.copy(), 0.0, 1.0)

    def sync(self) -> None:
        """Take the measured joint angles as the reference, at rest."""
        self.state[0] = self.scene.data.qpos[self.robot.qpos]
        self.state[1] = 0.0

    def hold(self) -> None:
        """Stay where the reference is."""
        self.goal = self.goal._replace(posture=self.state[0].copy(), target_weight=0.0)

    def set_obstacles(self, obstacles: FloatArray) -> None:
        """Set what to keep clear of: capsules and range, (n, 8) [m]."""
        self.obstacles = np.ascontiguousarray(obstacles)

    def attach(self, spheres: FloatArray) -> None:
        """Move as if spheres were fixed to the flange: what the gripper holds.

        Args:
            spheres: Centre in the flange frame and radius, (n, 4) [m]; empty to detach.
        """
        envelope = envelope_of(self.robot.arm.name)
        count = len(spheres)
        self._model = self._model._replace(
            sphere_links=np.concatenate([envelope.sphere_links, np.full(count, 6.0)]),
            spheres=np.concatenate([envelope.spheres, spheres.reshape(count, 4)]),
            sphere_meets_table=np.concatenate(
                [envelope.sphere_meets_table, np.zeros(count)]
            ),
        )

    def solve_posture(self, pose: FloatArray) -> FloatArray | None:
        """Return the joint angles nearest to the reference that reach a gripper pose.

        The arm keeps the branch in which it waits, where it can: changing the elbow,
        the shoulder or the wrist on the way sweeps it through objects and itself.

        Args:
            pose: World from gripper at the tool centre point, (4, 4).

        Returns:
            (6,) [rad], or None where the arm cannot be.
        """
        dh, limit, links, capsules = ik_constants(self.robot.arm.name)
        base, posture = self.robot.world_from_base, np.empty(6)
        found = choose_posture(
            *(dh, base, links, capsules, limit),
            *(self.park, self.state[0], pose, posture),
        )
        return posture if found else None

    def aim(self, pose: FloatArray, posture: FloatArray | None = None) -> None:
        """Set the pose, (4, 4), that the tool centre point shall go to."""
        self.goal = ArmTarget(
            position=np.ascontiguousarray(pose[:3, 3]),
            rotation=np.ascontiguousarray(pose[:3, :3]),
            posture=self.state[0].copy() if posture is None else posture,
            target_weight=1.0,
            posture_weight=1.0,
        )

    def take(self, goal: ArmTarget) -> None:
        """Take a goal that is in the memory of RMPflow already."""
        self.goal = goal
        self._root.take(goal)

    def follow_posture(self, posture: FloatArray) -> None:
        """Go to joint angles, (6,) [rad]."""
        self.goal = ArmTarget(
            np.zeros(3), np.eye(3), np.ascontiguousarray(posture), 0.0, 20.0
        )

    def load(self) -> Workspace:
        """Return the memory of RMPflow with all that is new since the last step."""
        self._root.load(self._model, self.goal, self.leaves)
        return self._root

    def step(self) -> None:
        """Advance the reference by one physics step and command the servos."""
        integrate(
            self._root,
            self._model,
            self.goal,
            self.leaves,
            self.state,
            self.obstacles,
            SUBSTEP_S,
            SUBSTEPS,
        )
        self.command()

    def command(self) -> None:
        """Send the reference to the servos, led by their lag."""
        control = self.scene.data.ctrl
        control[self.robot.ctrl] = self.state[0] + self.robot.arm.lag_s * self.state[1]
        control[self.robot.gripper_ctrl] = self.opening_m

    def tcp_pose(self) -> FloatArray:
        """Return the measured world from gripper at the tool centre point, (4, 4)."""
        return self._tcp(np.asarray(self.scene.data.qpos[self.robot.qpos]))

    def reference_pose(self) -> FloatArray:
        """Return where the reference puts the tool centre point, (4, 4)."""
        return self._tcp(self.state[0])

    def _tcp(self, q: FloatArray) -> FloatArray:
        placed = np.empty((7, 4, 4))
        frames(self._dh, self.robot.world_from_base, q, placed)
        pose: FloatArray = placed[6]
        pose[:3, 3] += TCP_OFFSET_M * pose[:3, 2]
        return pose

    def capsules(self, q: FloatArray | None = None) -> FloatArray:
        """Return the space that the arm fills at ``q`` or now: capsules (n, 7) [m]."""
        envelope = envelope_of(self.robot.arm.name)
        placed = np.empty((7, 4, 4))
        if q is None:
            q = np.asarray(self.scene.data.qpos[self.robot.qpos])
        frames(self._dh, self.robot.world_from_base, q, placed)
        out = np.empty((len(envelope.capsules), 7))
        place_capsules(placed, envelope.capsule_links, envelope.capsules, out)
        return out
