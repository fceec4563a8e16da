"""Policies from parts: any planner with any grounder, closed or open loop."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lemma.policies.interfaces import (
    Decision,
    Grounder,
    PastStep,
    Planner,
    PolicyInput,
)
from lemma.tasks.subtask import Primitive, SubTask


@dataclass(frozen=True)
class PlannerWithGrounder:
    """A policy of two levels (paper, section V)."""

    planner: Planner
    grounder: Grounder

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Plan for all episodes at once, then ground for those that go on."""
        subtasks = self.planner.plan(inputs)
        going = [i for i, s in enumerate(subtasks) if s.primitive is not Primitive.STOP]
        decisions = [Decision(subtask, None) for subtask in subtasks]
        if going:
            grounded = self.grounder.ground(
                [inputs[i] for i in going], [subtasks[i] for i in going]
            )
            for i, found in zip(going, grounded, strict=True):
                why = "" if found else f"No pose was found for: {subtasks[i]}."
                decisions[i] = Decision(subtasks[i], found, why)
        return decisions


@dataclass(frozen=True)
class MultiStep:
    """A planner that sees the first view only: the paper's multi-step planning.

    The whole plan follows from the first image and the planner's own decisions,
    whatever becomes of them.
    """

    planner: Planner

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Plan as if nothing had changed on the table."""
        return self.planner.plan([_as_at_first(given) for given in inputs])


def _as_at_first(given: PolicyInput) -> PolicyInput:
    first = given.past[0].view if given.past else given.view
    past = tuple(PastStep(first, step.subtask) for step in given.past)
    return replace(given, view=first, past=past)
