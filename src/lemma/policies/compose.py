"""Policies from parts: any planner with any grounder, closed or open loop.

If a model does not read outcomes itself, another robot of the team tries a sub-task
that was refused.
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
    """A policy of two levels (paper, section V)."""

    planner: Planner
    grounder: Grounder

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Plan for all episodes at once, then ground for those that go on."""
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

    The whole plan follows from the first image and the planner's own decisions,
    whatever becomes of them.
    """

    planner: Planner

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Plan as if nothing had changed on the table."""
        at_first = [_as_at_first(policy_input) for policy_input in inputs]
        return self.planner.plan(visible_to(self.planner, at_first))


def _as_at_first(policy_input: PolicyInput) -> PolicyInput:
    first = policy_input.past[0].view if policy_input.past else policy_input.view
    past = tuple(PastStep(first, step.subtask) for step in policy_input.past)
    return replace(policy_input, view=first, past=past)


@dataclass(frozen=True)
class RetryingPlanner(Composite):
    """A planner that reads no outcomes, with the rule for refused sub-tasks.

    A refused sub-task changed nothing, so the planner is asked again as if it had not
    been tried, and what it decides on is given to the next robot of the team that was
    not refused the same. When all were, it is told of everything and goes on.
    """

    planner: Planner

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the planner's sub-tasks, each for a robot that was not refused it."""
        untried = [_as_untried(policy_input) for policy_input in inputs]
        decided = self.planner.plan(visible_to(self.planner, untried))
        return [
            _for_another(policy_input, subtask)
            for policy_input, subtask in zip(inputs, decided, strict=True)
        ]


@dataclass(frozen=True)
class RetryingPolicy(Composite):
    """The same for a policy that plans and grounds at once: its poses remain."""

    policy: Policy

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the policy's decisions, each for a robot that was not refused it."""
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
    """Return what was refused since anything was carried out, the last one first."""
    found = []
    for step in reversed(policy_input.past):
        if step.outcome not in REFUSED:
            break
        found.append(step.subtask)
    return found


def _as_untried(policy_input: PolicyInput) -> PolicyInput:
    """Return an input without the last refused sub-task, while robots are left."""
    refused = _refused(policy_input)
    same = 0
    while same < len(refused) and _is_alike(refused[same], refused[0]):
        same += 1
    left = 0 < same < len(policy_input.robots)
    return policy_input.with_past(policy_input.past[:-same]) if left else policy_input


def _for_another(policy_input: PolicyInput, subtask: SubTask) -> SubTask:
    """Return a sub-task for the next robot that was not refused it, if there is one."""
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
