"""One attempt at an instance with motor commands to one robot.

The hand is led along poses of any orientation: inverse kinematics turns them into the
joint angles that the environment takes, 50 times a second. The other robots are told to
stay where they are.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lemma.audit.attack import AttemptOver, Lost
from lemma.audit.hand import turned_near
from lemma.core.poses import FloatArray, Pose2
from lemma.env.base_env import EnvSnapshot
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.robots.could import Could, could_of
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.reach import Reach, gripper_ik, reach_of
from lemma.robots.ur.build import ARMS
from lemma.scene.objects.entity import kind_of
from lemma.scene.spec import RobotPlacement
from lemma.tasks.instance import Instance
from lemma.tasks.suite import FREE_SPLIT

STEP_S = 0.02
"""Between two commands: what lies on a held stick falls if the arm jerks."""
_PATIENCE_S = 2.5
"""How long an attempt waits at its end for the environment to call it a success."""
_SPEED = 0.6
"""Share of the joints' velocity limits at which the hand is led."""
_CLOSE_RAD = 0.01
_STUCK_S = 0.6


def control_config(task: str) -> EnvConfig:
    """Return the environment in which attacks act, and their replays."""
    return EnvConfig(
        task=task, control="joint_position", control_hz=1.0 / STEP_S, split=FREE_SPLIT
    )


class ControlTrial:
    """What an attack at control level sees and may do."""

    def __init__(
        self,
        env: ControlEnv,
        robot: str,
        rng: np.random.Generator,
        attempt: int = 0,
    ) -> None:
        """Begin an attempt.

        Args:
            env: At the beginning of an episode: one of :func:`control_config`.
            robot: Who acts.
            rng: Where every draw comes from.
            attempt: Number of the attempt.
        """
        self._env = env
        self.instance = env.instance
        self.goal = env.instance.goal
        self.scene = env.episode.simulation.scene
        self.robot = robot
        self.rng = rng
        self.attempt = attempt
        self.best_progress = 0.0
        """Most of the goal that ever held."""
        self._number = self.scene.spec.robot_names.index(robot)
        self._index = self.scene.robot(robot)
        self._reward = 0.0
        self._over = False
        rows = [self.scene.data.qpos[r.qpos] for r in self.scene.robots]
        self._row = np.array([[*row, FINGER_OPENING_M] for row in rows])
        self._commands: list[NDArray[np.float32]] = []
        self._box = env.action_layout.box()

    @property
    def placement(self) -> RobotPlacement:
        """The robot that acts: arm type and base."""
        return self.scene.spec.robots[self._number]

    @property
    def reach(self) -> Reach:
        """Its reach, pointing down."""
        return reach_of(self.placement.arm)

    @property
    def could(self) -> Could:
        """What it could do at most, however it turns its hand."""
        return could_of(self.placement.arm)

    @property
    def acted(self) -> bool:
        """Whether anything was commanded."""
        return bool(self._commands)

    @property
    def joints(self) -> FloatArray:
        """Angles that were commanded last, (6,) [rad]."""
        return self._row[self._number, :6]

    def pose(self, name: str) -> Pose2:
        """Return where an object is now, seen from above."""
        return self.scene.pose2(name)

    def height(self, name: str) -> float:
        """Return how high an object's frame is [m]."""
        return self.scene.pose(name).position[2]

    def radius(self, pose: Pose2) -> float:
        """Return the distance of a position from the robot's base [m]."""
        return self.placement.base.distance(pose)

    def outward(self, pose: Pose2) -> float:
        """Return the direction from the robot's base to a position [rad]."""
        base = self.placement.base
        return math.atan2(pose.y - base.y, pose.x - base.x)

    def postures(self, hand: FloatArray) -> FloatArray:
        """Return joint angles, (n, 6), that put the hand at a pose, (4, 4)."""
        return gripper_ik(self.placement.arm, self.placement.base.matrix(), hand)

    def can(self, *hands: FloatArray) -> bool:
        """Whether the hand can be at each of some poses."""
        return all(len(self.postures(hand)) > 0 for hand in hands)

    def posture(self, hand: FloatArray) -> FloatArray | None:
        """Return the joint angles for a pose that are nearest to the present ones."""
        limits = np.array(ARMS[self.placement.arm].joint_range)
        near = [turned_near(q, self.joints, limits) for q in self.postures(hand)]
        if not near:
            return None
        return min(near, key=lambda q: float(np.abs(q - self.joints).max()))

    def command(self, joints: FloatArray, opening_m: float) -> None:
        """Send one action.

        Raises:
            AttemptOver: The goal is reached, or the time is up.
            Lost: It cannot be reached any more.
        """
        self._row[self._number, :6] = joints
        self._row[self._number, 6] = opening_m
        # As numbers of single precision, which is what a space of actions holds.
        action = np.clip(self._row.astype(np.float32), self._box.low, self._box.high)
        self._commands.append(action)
        self._reward, terminated, truncated = self._env.advance(action)
        self.best_progress = max(self.best_progress, self._env.episode.progress)
        self._over = terminated or truncated
        if self._over:
            raise AttemptOver
        if not set(self._env.episode.fallen).isdisjoint(self.goal.entities):
            raise Lost

    def wait(self, seconds: float, opening_m: float) -> None:
        """Stay, with the fingers told to open or to close."""
        for _ in range(round(seconds / STEP_S)):
            self.command(self.joints.copy(), opening_m)

    def turn_to(self, joints: FloatArray, opening_m: float, speed: float = 1.0) -> None:
        """Lead the joints straight to angles, and wait until they are there."""
        start = self.joints.copy()
        limits = np.array(ARMS[self.placement.arm].velocity_limits)
        seconds = float((np.abs(joints - start) / limits).max()) / (_SPEED * speed)
        count = max(1, math.ceil(seconds / STEP_S))
        for i in range(1, count + 1):
            self.command(start + (joints - start) * (i / count), opening_m)
        self.settle(opening_m)

    def settle(self, opening_m: float) -> None:
        """Wait until the joints are where they were told to be, or are stuck."""
        for _ in range(round(_STUCK_S / STEP_S)):
            actual = self.scene.data.qpos[self._index.qpos]
            if float(np.abs(actual - self.joints).max()) < _CLOSE_RAD:
                return
            self.command(self.joints.copy(), opening_m)

    def go(self, hand: FloatArray, opening_m: float, speed: float = 1.0) -> bool:
        """Go to a pose of the hand, (4, 4); return whether there is a way."""
        joints = self.posture(hand)
        if joints is None:
            return False
        self.turn_to(joints, opening_m, speed)
        return True

    def lead(
        self, hands: Sequence[FloatArray], opening_m: float, speed_m_s: float = 0.25
    ) -> bool:
        """Lead the hand through poses in straight lines; False where it cannot go on.

        Between two poses the position is interpolated, and the orientation is that of
        the second.
        """
        at = self.hand()
        for hand in hands:
            length = float(np.linalg.norm(hand[:3, 3] - at[:3, 3]))
            count = max(1, math.ceil(length / (speed_m_s * STEP_S)))
            for i in range(1, count + 1):
                between = hand.copy()
                between[:3, 3] = at[:3, 3] + (hand[:3, 3] - at[:3, 3]) * (i / count)
                joints = self.posture(between)
                if joints is None:
                    return False
                self.command(joints, opening_m)
            at = hand
        self.settle(opening_m)
        return True

    def hand(self) -> FloatArray:
        """Return where the hand is, (4, 4)."""
        return self._env.episode.simulation.arms[self.robot].tcp_pose()

    def cargo(self) -> list[str]:
        """Return what can be moved and has not fallen off the table, but the stick."""
        fallen = self.scene.fallen
        return [
            name
            for name in self.scene.movable_names
            if kind_of(name).cargo and name not in fallen
        ]

    def snapshot(self) -> "Moment":
        """Return the moment, to come back to it: an attacker may try things out."""
        return Moment(self._env.snapshot(), self._row.copy(), len(self._commands))

    def restore(self, moment: "Moment") -> None:
        """Go back; what was done since was never done."""
        self._env.restore(moment.env)
        self._row = moment.row.copy()
        del self._commands[moment.commands :]
        self._over = False

    def finish(self) -> bool:
        """Wait for the environment to end the episode; return whether it succeeded."""
        try:
            if not self._over and self.best_progress > 0.0:
                self.wait(_PATIENCE_S, FINGER_OPENING_M)
        except AttemptOver:
            pass
        return self._over and self._reward > 0.0

    def what_was_done(self) -> dict[str, object]:
        """Return it, for a replay."""
        return {"commands": np.stack(self._commands)}


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment of a trial."""

    env: EnvSnapshot
    row: FloatArray
    commands: int


class ControlTable:
    """A compiled instance, from whose start attempts begin."""

    def __init__(self, instance: Instance) -> None:
        """Compile it."""
        self._env = ControlEnv(control_config(instance.task))
        self._env.set_table(options={"instance": instance})
        self._start: EnvSnapshot = self._env.snapshot()

    def begin(self, robot: str, rng: np.random.Generator, attempt: int) -> ControlTrial:
        """Set the table anew; see :class:`ControlTrial`."""
        self._env.restore(self._start)
        return ControlTrial(self._env, robot, rng, attempt)
