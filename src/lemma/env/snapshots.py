"""Snapshots of a simulation, and time counters of robots."""

from dataclasses import dataclass

from lemma.core.poses import FloatArray
from lemma.motion.reservations import WaitingTimes
from lemma.motion.rmpflow.workspace import ArmTarget
from lemma.scene.coasting import CoastingState


@dataclass
class RobotClock:
    """Time counter of one robot."""

    busy_s: float = 0.0
    """Executing sub-tasks [s]."""

    def idle_s(self, elapsed_s: float) -> float:
        """Return the time spent waiting so far [s]."""
        return max(0.0, elapsed_s - self.busy_s)


@dataclass(frozen=True, slots=True)
class ArmSnapshot:
    """State of an arm's motion that is not in the physics."""

    reference: FloatArray
    """Joint angles and velocities that the servos follow, (2, 6) [rad, rad/s]."""
    goal: ArmTarget
    opening_m: float
    """Commanded opening of the gripper [m]."""
    busy_s: float
    """See :class:`.RobotClock` [s]."""


@dataclass(frozen=True, slots=True)
class SimulationSnapshot:
    """A simulation between two sub-tasks or control steps."""

    physics: FloatArray
    """The full integration state."""
    arms: dict[str, ArmSnapshot]
    coasting: CoastingState
    """How far each object has moved without a robot."""
    waiting: WaitingTimes
    """Time that each arm has waited for others."""
