"""One attempt at an instance with motor commands to one robot.

The attack leads the hand along poses of any orientation. Inverse kinematics turns them
into joint angles, which the environment takes 50 times a second. The other robots are
commanded to stay where they are.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.audit.trial import AttemptOver, Trial
from lemma.core.poses import FloatArray, Pose2
from lemma.env.base_env import EnvSnapshot
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.robots.could import could_of
from lemma.robots.gripper import FINGER_OPENING_M, TCP_OFFSET_M
from lemma.robots.reach import gripper_ik
from lemma.robots.ur.build import ARMS
from lemma.robots.ur.kinematics import forward
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On
from lemma.tasks.instance import Instance
from lemma.tasks.suite import FREE_SPLIT

LEANS_RAD = tuple(math.radians(d) for d in range(0, 80, 5))
"""Angles between the fingers and straight down, smallest first."""


def leaning(spot: Pose2, z: float, lean: float = 0.0) -> FloatArray:
    """Return the pose of a hand whose fingers point down and ahead.

    Args:
        spot: Position of the tool centre point [m]. Its yaw is the direction in which
            the fingers point, seen from above; they close across it.
        z: Height of the tool centre point [m].
        lean: Angle from the vertical [rad]; at 0 the fingers point straight down.

    Returns:
        The pose of the tool centre point in the world, (4, 4).
    """
    c, s = math.cos(spot.yaw), math.sin(spot.yaw)
    down, ahead = math.cos(lean), math.sin(lean)
    pose = np.eye(4)
    pose[:3, 0] = (down * c, down * s, ahead)
    pose[:3, 1] = (s, -c, 0.0)
    pose[:3, 2] = (ahead * c, ahead * s, -down)
    pose[:3, 3] = (spot.x, spot.y, z)
    return pose


def drawn_back(hand: FloatArray, distance_m: float) -> FloatArray:
    """Return a hand, (4, 4), moved back along the direction of its fingers."""
    pose = hand.copy()
    pose[:3, 3] -= distance_m * hand[:3, 2]
    return pose


def moved(
    hand: FloatArray, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0
) -> FloatArray:
    """Return a hand at another position [m], with the same orientation."""
    pose = hand.copy()
    pose[:3, 3] += (dx, dy, dz)
    return pose


def ahead(hand: FloatArray, distance_m: float, heading: float) -> FloatArray:
    """Return a hand, (4, 4), moved along a horizontal direction [rad]."""
    return moved(hand, distance_m * math.cos(heading), distance_m * math.sin(heading))


STEP_S = 0.02
"""Time between two commands; a longer one would shake objects off a held stick."""
# Longest wait at the end of an attempt for the environment to report success.
_PATIENCE_S = 2.5
# Speed of the hand as a share of the joints' velocity limits.
_SPEED = 0.6
_CLOSE_RAD = 0.01
_STUCK_S = 0.6
_LIFT_M = 0.12
_CLOSE_S = 0.6
_TOUCH_DOWN_M = 0.003
_MISSED_M = 0.02
_STAND_BY_M = 0.38


def control_config(task: str) -> EnvConfig:
    """Return the configuration of the environment for attacks and their replays."""
    return EnvConfig(
        task=task, control="joint_position", control_hz=1.0 / STEP_S, split=FREE_SPLIT
    )


Moment = tuple[EnvSnapshot, FloatArray, int]
"""The environment, the last command of all robots, and the number of commands."""


class ControlTrial(Trial):
    """The actions of an attack at control level.

    A *hand* is a pose of the tool centre point in the world, (4, 4).
    """

    def __init__(
        self, env: ControlEnv, robot: str, rng: np.random.Generator, attempt: int = 0
    ) -> None:
        """Begin an attempt.

        Args:
            env: The environment, from :meth:`begin`.
            robot: Name of the robot that acts.
            rng: Source of every random draw.
            attempt: Number of the attempt, from 0.
        """
        super().__init__(env.episode, robot, rng, attempt)
        self._env = env
        self.could = could_of(self.placement.arm)
        """Upper bounds of the robot's reach with any orientation of the hand."""
        self._limits = np.array(ARMS[self.placement.arm].joint_range)
        self._index = self.scene.robot(robot)
        self._reward = 0.0
        self._over = False
        rows = [self.scene.data.qpos[r.qpos] for r in self.scene.robots]
        self._row = np.array([[*row, FINGER_OPENING_M] for row in rows])
        self._commands: list[NDArray[np.float32]] = []
        self._box = env.action_layout.box()

    @staticmethod
    def begin(instance: Instance) -> ControlEnv:
        """Return an environment in which attempts can be made."""
        env = ControlEnv(control_config(instance.task))
        env.set_table(options={"instance": instance})
        return env

    @property
    def joints(self) -> FloatArray:
        """Joint angles of the last command, (6,) [rad]."""
        return self._row[self.number, :6]

    def hand(self) -> FloatArray:
        """Return the present pose of the hand, (4, 4)."""
        return self.episode.simulation.arms[self.robot].tcp_pose()

    def height(self, name: str) -> float:
        """Return the height of an object's frame [m]."""
        return self.scene.pose(name).position[2]

    def resting_height(self, on: On) -> float:
        """Return the height of the middle of a top that lies on its bottom [m]."""
        return (
            self.height(on.bottom) + kind_of(on.bottom).top_m + kind_of(on.top).origin_m
        )

    def is_home(self, name: str, inside_m: float = 0.02) -> bool:
        """Whether a hand that points down can pick up a cube where it lies."""
        return self.radius(self.pose(name)) < self.reach.travel_m - inside_m

    def postures(self, hand: FloatArray) -> FloatArray:
        """Return all joint angles, (n, 6) [rad], that put the hand at a pose."""
        return gripper_ik(self.placement.arm, self.placement.base.matrix(), hand)

    def hand_at(self, joints: FloatArray) -> FloatArray:
        """Return the pose of the hand at joint angles, (4, 4)."""
        base = self.placement.base.matrix()
        hand: FloatArray = base @ forward(ARMS[self.placement.arm].dh, joints)
        hand[:3, 3] += TCP_OFFSET_M * hand[:3, 2]
        return hand

    def can(self, *hands: FloatArray) -> bool:
        """Whether inverse kinematics finds joint angles for all the poses."""
        return all(len(self.postures(hand)) > 0 for hand in hands)

    def posture(self, hand: FloatArray) -> FloatArray | None:
        """Return the joint angles for a pose that are nearest to the present ones.

        Returns:
            Joint angles, (6,) [rad]; None if the hand cannot be there.
        """
        found = self.postures(hand)
        # Whole turns are added where that brings a joint nearer.
        turned = found + np.round((self.joints - found) / math.tau) * math.tau
        near = np.where(np.abs(turned) > self._limits, found, turned)
        distances = np.abs(near - self.joints).max(axis=1, initial=0.0)
        return near[int(distances.argmin())] if len(near) else None

    def command(self, joints: FloatArray, opening_m: float) -> None:
        """Send one action.

        Args:
            joints: Joint angles, (6,) [rad].
            opening_m: Distance between the fingers [m].

        Raises:
            AttemptOver: The goal is reached, or the time is up.
            Lost: The goal cannot be reached any more.
        """
        self.acted = True
        self._row[self.number, :6] = joints
        self._row[self.number, 6] = opening_m
        # Action spaces are of single precision.
        action = np.clip(self._row.astype(np.float32), self._box.low, self._box.high)
        self._commands.append(action)
        self._reward, terminated, truncated = self._env.advance(action)
        self._over = terminated or truncated
        self.simulated_s += STEP_S
        self.look(self._over)

    def wait(self, seconds: float, opening_m: float = FINGER_OPENING_M) -> None:
        """Keep the joint angles for a time [s] while the fingers open or close."""
        for _ in range(round(seconds / STEP_S)):
            self.command(self.joints.copy(), opening_m)

    def settle(self, opening_m: float) -> None:
        """Wait until the joints are at the commanded angles, or are stuck."""
        for _ in range(round(_STUCK_S / STEP_S)):
            actual = self.scene.data.qpos[self._index.qpos]
            if float(np.abs(actual - self.joints).max()) < _CLOSE_RAD:
                return
            self.command(self.joints.copy(), opening_m)

    def go(self, hand: FloatArray, opening_m: float, speed: float = 1.0) -> bool:
        """Go to a pose, straight in joint space; return whether it is feasible."""
        joints, start = self.posture(hand), self.joints.copy()
        if joints is None:
            return False
        limits = np.array(ARMS[self.placement.arm].velocity_limits)
        seconds = float((np.abs(joints - start) / limits).max()) / (_SPEED * speed)
        count = max(1, math.ceil(seconds / STEP_S))
        for i in range(1, count + 1):
            self.command(start + (joints - start) * (i / count), opening_m)
        self.settle(opening_m)
        return True

    def lead(
        self, hands: Sequence[FloatArray], opening_m: float, speed_m_s: float = 0.25
    ) -> bool:
        """Lead the hand through poses in straight lines; False if it gets stuck.

        Between two poses the position is interpolated, and the orientation is that of
        the second.

        Args:
            hands: Poses of the hand, (4, 4) each.
            opening_m: Distance between the fingers [m].
            speed_m_s: Speed of the hand [m/s].
        """
        start = self.hand()
        for hand in hands:
            length = float(np.linalg.norm(hand[:3, 3] - start[:3, 3]))
            count = max(1, math.ceil(length / (speed_m_s * STEP_S)))
            for i in range(1, count + 1):
                between = hand.copy()
                between[:3, 3] = start[:3, 3] + (hand - start)[:3, 3] * (i / count)
                if not self.follow(between, opening_m):
                    return False
            start = hand
        self.settle(opening_m)
        return True

    def follow(self, hand: FloatArray, opening_m: float) -> bool:
        """Send one action towards a pose; return whether the hand can be there."""
        joints = self.posture(hand)
        if joints is not None:
            self.command(joints, opening_m)
        return joints is not None

    def stand_by(self, hand: FloatArray, opening_m: float) -> bool:
        """Go to a pose high above the table, on the way to another."""
        spot = Pose2(*hand[:2, 3])
        ahead = math.hypot(hand[0, 2], hand[1, 2])
        axis = hand[:, 2 if ahead > 0.05 else 0]
        high = self.at(0.6 * self.reach.travel_m, self.outward(spot))
        lean = 0.5 * math.acos(float(np.clip(-hand[2, 2], -1.0, 1.0)))
        way = Pose2(high.x, high.y, math.atan2(axis[1], axis[0]))
        return self.go(leaning(way, _STAND_BY_M, lean), opening_m)

    def approach(
        self,
        hand: FloatArray,
        opening_m: float,
        back_m: float = 0.10,
        lift_m: float = 0.0,
    ) -> bool:
        """Go to a pose along the fingers' direction; return whether it is feasible.

        Args:
            hand: The pose.
            opening_m: Distance between the fingers [m].
            back_m: Length of the approach along the fingers [m].
            lift_m: Additional height at its start [m].
        """
        if not self.stand_by(hand, opening_m):
            return False
        before = drawn_back(hand, back_m)
        above = moved(before, dz=lift_m)
        if lift_m and self.can(above):
            self.go(above, opening_m)
        return self.go(before, opening_m) and self.lead([hand], opening_m, 0.12)

    def holds(
        self, name: str, lean: float = 0.0, ahead_m: float = 0.0
    ) -> Iterator[FloatArray]:
        """Yield hands that hold a cube where it lies.

        Args:
            name: The cube.
            lean: Lean of the hand, from the vertical [rad].
            ahead_m: Distance of the cube's middle ahead of the tool centre point [m].
        """
        cube, z = self.pose(name), self.height(name)
        faces = [cube.yaw + 0.5 * math.pi * k for k in range(4)]
        # Across the three faces that point outwards most.
        faces.sort(key=lambda yaw: -math.cos(yaw - self.outward(cube)))
        for yaw in faces[:3]:
            hand = drawn_back(leaning(Pose2(cube.x, cube.y, yaw), z, lean), ahead_m)
            if self.can(hand, drawn_back(hand, 0.08), moved(hand, dz=_LIFT_M)):
                yield hand

    def pick_up(self, hand: FloatArray) -> bool:
        """Close the fingers at a pose and lift; return whether it is feasible."""
        if not self.approach(hand, FINGER_OPENING_M):
            return False
        self.wait(_CLOSE_S, 0.0)
        self.lead([moved(hand, dz=_LIFT_M)], 0.0, 0.3)
        return True

    def take(self, name: str, lean: float = 0.0, ahead_m: float = 0.0) -> bool:
        """Pick up a cube; see :meth:`holds`. Return whether it is feasible."""
        hand = next(self.holds(name, lean, ahead_m), None)
        return hand is not None and self.pick_up(hand)

    def put(self, hand: FloatArray, back_m: float = 0.10, lift_m: float = 0.0) -> bool:
        """Release at a pose and draw back; see :meth:`approach`."""
        there = self.approach(hand, 0.0, back_m, lift_m)
        if there:
            self.let_go(hand)
        return there

    def let_go(self, hand: FloatArray) -> None:
        """Open the fingers, draw back and get out of the way."""
        self.wait(_CLOSE_S)
        self.lead([drawn_back(hand, 0.10)], FINGER_OPENING_M, 0.2)
        self.stand_by(hand, FINGER_OPENING_M)

    def set_down(self, name: str, spot: Pose2, bottom_m: float = 0.0) -> bool:
        """Pick up a cube and set it down.

        Args:
            name: The cube.
            spot: Pose of its middle; the fingers close across its yaw.
            bottom_m: Height of the surface below it [m].

        Returns:
            Whether it now stands there.
        """
        put = leaning(spot, bottom_m + CUBE_EDGE_M / 2 + _TOUCH_DOWN_M)
        if not self.can(put) or not self.take(name) or not self.put(put):
            return False
        return self.pose(name).distance(spot) < _MISSED_M

    def snapshot(self) -> Moment:
        """Return the present moment, for :meth:`restore`."""
        return self._env.snapshot(), self._row.copy(), len(self._commands)

    def restore(self, moment: Moment) -> None:
        """Return to a moment and undo all later actions."""
        snapshot, row, count = moment
        self._env.restore(snapshot)
        self._row = row.copy()
        del self._commands[count:]
        self._over = False

    def finish(self) -> bool:
        """Wait for the environment to end the episode; return whether it succeeded."""
        with suppress(AttemptOver):
            if not self._over and self.best_progress > 0.0:
                self.limit_s = math.inf
                self.wait(_PATIENCE_S)
        return self._over and self._reward > 0.0

    def record(self) -> dict[str, Any]:
        """Return the commands, (steps, robots, numbers of one robot's action)."""
        return {"commands": np.stack(self._commands)}
