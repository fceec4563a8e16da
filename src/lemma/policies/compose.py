"""Policies composed of any planner and any grounder, in closed or open loop.

For models that do not read outcomes, a wrapper gives a refused sub-task to another
robot of the team.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lemma.core.robot_names import robot_names
from lemma.motion.outcome import REFUSED
from lemma.policies.interfaces import (
    Composite,
    Decision,
    Grounder,
    PastStep,
    Planner,
    Policy,
    PolicyInput,
    proposals,
    visible_to,
)
from lemma.tasks.subtask import Primitive, SubTask


@dataclass(frozen=True)
class PlannerWithGrounder(Composite):
    """A two-level policy (paper, section V)."""

    planner: Planner
    grounder: Grounder

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Plan for all episodes as a batch, then ground those that do not stop."""
        decisions = proposals(self.planner, inputs)
        subtasks = [decision.subtask for decision in decisions]
        going = [i for i, s in enumerate(subtasks) if s.primitive is not Primitive.STOP]
        if going:
            grounded = self.grounder.ground(
                visible_to(self.grounder, [inputs[i] for i in going]),
                [subtasks[i] for i in going],
            )
            for i, found in zip(going, grounded, strict=True):
                why = "" if found else f"No pose was found for: {subtasks[i]}."
                decisions[i] = replace(decisions[i], grounded=found, explanation=why)
        return decisions


@dataclass(frozen=True)
class MultiStep(Composite):
    """A planner that sees the first view only: the paper's multi-step planning.

    The plan depends only on the first image and the planner's own decisions, not on
    their outcomes.
    """

    planner: Planner

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Plan from the first view and the past decisions, without outcomes."""
        at_first = [_as_at_first(policy_input) for policy_input in inputs]
        return self.planner.plan(visible_to(self.planner, at_first))


def _as_at_first(policy_input: PolicyInput) -> PolicyInput:
    first = policy_input.past[0].view if policy_input.past else policy_input.view
    past = tuple(PastStep(first, step.subtask) for step in policy_input.past)
    return replace(policy_input, view=first, past=past)


@dataclass(frozen=True)
class RetryingPlanner(Composite):
    """A planner that does not read outcomes, with a rule for refused sub-tasks.

    A refused sub-task changes nothing in the scene. So the planner plans again without
    the refused attempt in its input, and the sub-task goes to the next robot of the
    team that has not refused it. Once all have refused, the planner gets all attempts
    as input.
    """

    planner: Planner

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the planner's sub-tasks, each for a robot that has not refused it."""
        untried = [_as_untried(policy_input) for policy_input in inputs]
        decided = self.planner.plan(visible_to(self.planner, untried))
        return [
            _for_another(policy_input, subtask)
            for policy_input, subtask in zip(inputs, decided, strict=True)
        ]


@dataclass(frozen=True)
class RetryingPolicy(Composite):
    """:class:`RetryingPlanner` for a policy of one level; it keeps the poses."""

    policy: Policy

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the policy's decisions, each for a robot that has not refused it."""
        untried = [_as_untried(policy_input) for policy_input in inputs]
        decided = self.policy.act(visible_to(self.policy, untried))
        found = []
        for policy_input, decision in zip(inputs, decided, strict=True):
            subtask = _for_another(policy_input, decision.subtask)
            grounded = decision.grounded
            if grounded is not None:
                grounded = replace(grounded, robot=subtask.robot)
            found.append(replace(decision, subtask=subtask, grounded=grounded))
        return found


def _refused(policy_input: PolicyInput) -> list[SubTask]:
    """Return the sub-tasks refused since the last executed one, latest first."""
    found = []
    for step in reversed(policy_input.past):
        if step.outcome not in REFUSED:
            break
        found.append(step.subtask)
    return found


def _as_untried(policy_input: PolicyInput) -> PolicyInput:
    """Return an input without the refused sub-tasks, until all robots have refused."""
    refused = _refused(policy_input)
    same = 0
    while same < len(refused) and _is_alike(refused[same], refused[0]):
        same += 1
    left = 0 < same < len(policy_input.robots)
    return policy_input.with_past(policy_input.past[:-same]) if left else policy_input


def _for_another(policy_input: PolicyInput, subtask: SubTask) -> SubTask:
    """Return a sub-task for the next robot that has not refused it, if any."""
    tried = {one.robot for one in _refused(policy_input) if _is_alike(one, subtask)}
    if subtask.robot not in tried:
        return subtask
    team = robot_names(len(policy_input.robots))
    first = team.index(subtask.robot)
    others = (*team[first + 1 :], *team[:first])
    return next(
        (replace(subtask, robot=name) for name in others if name not in tried), subtask
    )


def _is_alike(one: SubTask, other: SubTask) -> bool:
    return replace(one, robot=other.robot) == other
