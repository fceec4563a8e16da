"""How a sub-task ended, and why."""

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """The ways in which executing a sub-task can end."""

    SUCCESS = "success"
    """The motion was carried out. Whether it served the goal is another matter."""
    STOPPED = "stopped"
    """The policy said ``stop``."""
    INVALID = "invalid"
    """The sub-task makes no sense: an unknown entity, hooking with a cube. Or it does,
    and the policy found no pose for it."""
    UNREACHABLE = "unreachable"
    """The robot's arm cannot get there."""
    NOTHING_TO_PICK = "nothing_to_pick"
    """There is nothing graspable where the gripper should close."""
    OVERLOAD = "overload"
    """What it grasped is too heavy for the robot's hand or its arm."""
    MISSED_GRASP = "missed_grasp"
    """The fingers closed on nothing."""
    DROPPED = "dropped"
    """The held object was lost, or an object fell off the table."""
    FALLEN = "fallen"
    """An object that it needs has fallen off the table before."""
    THROWN = "thrown"
    """An object flew, or moved on by itself; the episode has failed. See
    :mod:`lemma.scene.coasting`."""
    RULE = "rule"
    """The rule of the goal was broken; the episode has failed. See
    :mod:`lemma.tasks.teams.rule`."""
    COLLISION = "collision"
    """Something was in the way."""
    TIMEOUT = "timeout"
    """The motion did not end in time."""
    DEADLOCK = "deadlock"
    """Robots at work at the same time waited for each other, or one for too long."""
    OUT_OF_TIME = "out_of_time"
    """The episode's time was over."""


REFUSED = frozenset(
    {
        Outcome.INVALID,
        Outcome.UNREACHABLE,
        Outcome.NOTHING_TO_PICK,
        Outcome.OVERLOAD,
        Outcome.FALLEN,
    }
)
"""Ends of what a robot cannot do: a real arm would stop for its protection."""


@dataclass(frozen=True, slots=True)
class SkillResult:
    """How one grounded sub-task went."""

    outcome: Outcome
    explanation: str
    """One sentence for a person."""
    duration_s: float
    """Simulated time that it took [s]."""

    @property
    def ok(self) -> bool:
        """Whether the motion was carried out."""
        return self.outcome in (Outcome.SUCCESS, Outcome.STOPPED)

    @property
    def refused(self) -> bool:
        """Whether the robot could not do it at all."""
        return self.outcome in REFUSED


def has_fallen(entity: str) -> str:
    """Return why nothing can be done with an object that is on the floor."""
    return f"The {entity} has fallen off the table, where nobody reaches it."


class SkillFailure(Exception):
    """Raised inside a skill to end it; the skill turns it into a result."""

    def __init__(self, outcome: Outcome, explanation: str) -> None:
        """Keep the outcome and its explanation."""
        super().__init__(explanation)
        self.outcome = outcome
        self.explanation = explanation
