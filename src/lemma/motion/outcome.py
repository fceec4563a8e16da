"""Outcomes of sub-tasks."""

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """The outcome of the execution of a sub-task."""

    SUCCESS = "success"
    """The motion was carried out. This does not mean that it serves the goal."""
    STOPPED = "stopped"
    """The policy returned ``stop``."""
    INVALID = "invalid"
    """The sub-task is invalid, such as one with an unknown entity, or hooking with a
    cube; or the policy found no pose for it."""
    UNREACHABLE = "unreachable"
    """The robot's arm cannot reach a pose of the sub-task."""
    NOTHING_TO_PICK = "nothing_to_pick"
    """There is no object at the pick pose that the gripper can grasp."""
    OVERLOAD = "overload"
    """The grasped object is too heavy for the robot's hand or its arm."""
    MISSED_GRASP = "missed_grasp"
    """The fingers closed without an object between them."""
    DROPPED = "dropped"
    """The held object was lost, or an object fell off the table."""
    FALLEN = "fallen"
    """An object that it needs had fallen off the table before."""
    THROWN = "thrown"
    """An object flew, or kept moving without a robot; the episode has failed. See
    :mod:`lemma.scene.coasting`."""
    RULE = "rule"
    """The rule of the goal was broken; the episode has failed. See
    :mod:`lemma.tasks.teams.rule`."""
    COLLISION = "collision"
    """An obstacle blocked the arm."""
    TIMEOUT = "timeout"
    """A motion exceeded its time limit."""
    DEADLOCK = "deadlock"
    """Busy robots waited for each other, or one of them waited too long."""
    OUT_OF_TIME = "out_of_time"
    """The episode's time ran out."""


REFUSED = frozenset(
    {
        Outcome.INVALID,
        Outcome.UNREACHABLE,
        Outcome.NOTHING_TO_PICK,
        Outcome.OVERLOAD,
        Outcome.FALLEN,
    }
)
"""Outcomes of infeasible sub-tasks: a real arm would make a protective stop."""


@dataclass(frozen=True, slots=True)
class SkillResult:
    """The result of one grounded sub-task."""

    outcome: Outcome
    explanation: str
    """One sentence for humans."""
    duration_s: float
    """Simulated duration [s]."""

    @property
    def ok(self) -> bool:
        """Whether the motion was carried out."""
        return self.outcome in (Outcome.SUCCESS, Outcome.STOPPED)

    @property
    def refused(self) -> bool:
        """Whether the sub-task was infeasible for the robot."""
        return self.outcome in REFUSED


def has_fallen(entity: str) -> str:
    """Return the explanation for an object that has fallen off the table."""
    return f"The {entity} has fallen off the table, where nobody reaches it."


class SkillFailure(Exception):
    """Ends a skill; :meth:`.SkillRunner.run` turns it into a result."""

    def __init__(self, outcome: Outcome, explanation: str) -> None:
        """Store the outcome and its explanation, one sentence."""
        super().__init__(explanation)
        self.outcome = outcome
        self.explanation = explanation
