"""Controllers, which drive the arms by the actions of an environment.

Every action keeps the motors within the limits of their robot. References move at no
more than 95% of a joint's velocity limit and with bounded acceleration, and servos
catch up no faster. Torques that would exceed a joint's velocity limit within a physics
step are reduced to reach just that limit. The safety filter
(:mod:`lemma.env.control.safety_filter`) likewise slows motions that would collide. A
real robot would make a protective stop instead.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lemma.core.engine import mujoco
from lemma.core.poses import FloatArray
from lemma.env.control.motor_commands import (
    Team,
    end,
    run_positions,
    run_velocities,
    step_torques,
)
from lemma.env.control.safety_filter import SafetyFilter
from lemma.motion.arm_motion import ArmMotion
from lemma.scene.build import STEPS_PER_TICK


@dataclass(frozen=True, kw_only=True)
class StepSize:
    """Scale of the actions of delta control modes: the motion for a value of 1."""

    position_m: float = 0.05
    """Along each axis [m]."""
    rotation_rad: float = 0.25
    """About each axis [rad]."""


class Controller(ABC):
    """Drives the arms of a scene by actions, which have one row for each arm."""

    def __init__(self, arms: Sequence[ArmMotion], step: StepSize) -> None:
        """Take over the arms where they are.

        Args:
            arms: All arms of a scene, in the order of an action's rows.
            step: Scale of actions, for delta control modes.
        """
        self.arms = arms
        self.step = step
        self.scene = arms[0].scene
        self.guard = SafetyFilter(arms)
        self.openings = np.array([arm.opening_m for arm in arms])
        """Commanded openings of the grippers, (n,) [m]."""
        self.states = np.stack([arm.state for arm in arms])
        """The references of all arms, (n, 2, 6) [rad, rad/s]."""
        for arm, state in zip(arms, self.states, strict=True):
            # Share memory: moving or restoring an arm updates it here too.
            arm.state = state
        self._busy_ticks = np.zeros(len(arms), np.int64)
        self.team: Team = (
            *(self.scene.physics, self.guard.arrays, self.guard.records),
            *(self.states, self.openings, self._busy_ticks),
        )
        """First argument of each kernel in :mod:`lemma.env.control.motor_commands`:
        arrays that kernels read and write in place."""

    def check(self, rows: FloatArray) -> None:  # noqa: B027 - bounds are mostly enough
        """Check an action; changes nothing.

        Raises:
            InvalidActionError: It is in bounds, but invalid.
        """

    def command(self, rows: FloatArray) -> None:
        """Set the next action, (n, k), with the gripper opening in the last column."""
        self.openings[:] = rows[:, -1]
        for arm, opening_m in zip(self.arms, self.openings.tolist(), strict=True):
            arm.opening_m = opening_m

    @abstractmethod
    def run(self, ticks: int) -> None:
        """Advance the physics by servo ticks, and command the motors meanwhile."""

    def busy_ticks(self) -> list[int]:
        """Return the number of servo ticks in which each arm moved since the last call.

        An arm moves if, at the end of a tick, a joint is faster than 0.02 rad/s or a
        finger is faster than 2 mm/s.
        """
        found = self._busy_ticks.tolist()
        self._busy_ticks[:] = 0
        return found


class JointController(Controller):
    """A controller with one number for each joint."""

    kernel: Callable[..., None]
    """See :mod:`lemma.env.control.motor_commands`."""

    def __init__(self, arms: Sequence[ArmMotion], step: StepSize) -> None:
        """Take over the arms where they are; every command is 0."""
        super().__init__(arms, step)
        self.wanted = np.zeros((len(arms), 6))
        # Bind arguments once: collecting them takes as long as the call.
        self._run = partial(self.kernel, self.team, self.wanted)

    def command(self, rows: FloatArray) -> None:
        """Set joint angles [rad], speeds [rad/s] or torques [N m]."""
        super().command(rows)
        self.wanted[:] = rows[:, :6]

    def run(self, ticks: int) -> None:
        """Advance the references and the physics by servo ticks."""
        self._run(ticks)


class PositionController(JointController):
    """Moves joints to target angles with trapezoidal velocity profiles."""

    kernel = staticmethod(run_positions)


class VelocityController(JointController):
    """Moves joints at given velocities; they stop at their position limits.

    The reference angles are the measured ones.
    """

    kernel = staticmethod(run_velocities)


class TorqueController(JointController):
    """Adds torques to gravity compensation, reduced where a joint would be too fast."""

    kernel = staticmethod(step_torques)

    def __init__(self, arms: Sequence[ArmMotion], step: StepSize) -> None:
        """Take over the arms where they are; every torque is 0."""
        super().__init__(arms, step)
        data, count = self.scene.data, self.scene.model.nv
        self._efforts = np.array([arm.robot.arm.effort_limits for arm in arms])
        self._inertia = np.empty((count, count))
        forces = (data.qfrc_bias, data.qfrc_passive)
        self._run = partial(self._run, self._inertia, *forces)

    def command(self, rows: FloatArray) -> None:
        """Set joint torques [N m]."""
        super().command(rows)
        np.clip(self.wanted, -self._efforts, self._efforts, out=self.wanted)

    def run(self, ticks: int) -> None:
        """Run servo ticks with the torques that the joints' velocity limits allow."""
        physics, _, records, _, _, counts = self.team
        for _ in range(ticks):
            self.guard.look()
            for _ in range(STEPS_PER_TICK):
                self._update_dynamics()
                self._run()
            end(physics, records, counts)

    def _update_dynamics(self) -> None:
        """Compute the inertia matrix and bias forces of the present state."""
        model, data = self.scene.model, self.scene.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        mujoco.mj_fullM(model, data, self._inertia)
