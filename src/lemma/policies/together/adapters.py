"""Adapters from sequential policies to team policies, with one order or several."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from lemma.motion.outcome import Outcome
from lemma.planning.grounding import GroundedOption, ground_or_refuse
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import (
    Composite,
    Decision,
    Effort,
    Grounder,
    PastStep,
    Planner,
    Policy,
    PolicyInput,
    proposals,
    visible_to,
)
from lemma.policies.oracle import OracleGrounder
from lemma.policies.together.interfaces import (
    Orders,
    TeamInput,
    TeamOracleInput,
    TeamPolicy,
    orders_of,
)
from lemma.scene.objects.entity import SHARED, pair_regions
from lemma.tasks.teams.dependencies import predecessors


@dataclass(frozen=True)
class Symbols(Composite):
    """A planner as a policy whose decisions have no poses."""

    planner: Planner

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the planner's decisions."""
        return proposals(self.planner, inputs)


@dataclass(frozen=True)
class WithExpertPoses(Composite):
    """A symbolic team policy; the expert grounds each order when it begins."""

    policy: TeamPolicy
    grounder: Grounder = OracleGrounder()  # noqa: RUF009 - it is frozen
    """Marks the policy as an oracle."""

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return the policy's orders without poses."""
        answers = self.policy.act_together(_visible_to(self.policy, inputs))
        return [
            replace(
                orders,
                decisions=tuple(
                    replace(one, grounded=None) if isinstance(one, Decision) else one
                    for one in orders.decisions
                ),
            )
            for orders in map(orders_of, answers)
        ]


@dataclass(frozen=True)
class WithGrounder(Composite):
    """A symbolic team policy with a grounder."""

    policy: TeamPolicy
    grounder: Grounder

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return the policy's orders with poses."""
        answers = self.policy.act_together(_visible_to(self.policy, inputs))
        return [
            replace(orders, decisions=tuple(self._grounded(team_input, orders)))
            for team_input, orders in zip(inputs, map(orders_of, answers), strict=True)
        ]

    def _grounded(self, team_input: TeamInput, orders: Orders) -> list[Decision]:
        found = []
        for decision in orders.decisions:
            if isinstance(decision, Decision) and not decision.stops:
                asked = visible_to(self.grounder, [team_input])
                (poses,) = self.grounder.ground(asked, [decision.subtask])
                decision = replace(decision, grounded=poses)
            found.append(decision)
        return found


@dataclass(frozen=True)
class Turns(Composite):
    """A sequential policy that orders one sub-task at a time.

    It is called when no robot is working, with the same inputs as in turns.
    """

    policy: Policy

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return one order if no robot is working, otherwise none."""
        asked = [i for i, team_input in enumerate(inputs) if _is_quiet(team_input)]
        found = [Orders() for _ in inputs]
        if asked:
            answers = self.policy.act(
                visible_to(self.policy, [inputs[i] for i in asked])
            )
            for i, decision in zip(asked, answers, strict=True):
                found[i] = Orders((decision,))
        return found


@dataclass(frozen=True)
class Greedy(Composite):
    """A sequential policy that gives orders to free robots until it has no valid one.

    The policy decides on its next sub-task as if all active orders had succeeded. The
    sub-task becomes an order, and the policy decides again, while the sub-task is for a
    free robot, repeats no active or completed one, and is valid. A sub-task with the
    policy's own poses is valid if no active order involves its objects, because these
    poses are from the present view. A sub-task of an oracle planner is valid if the
    expert can ground it. If no robot is working, every sub-task becomes an order, as in
    turns, and only then does ``stop`` count.
    """

    policy: Policy
    symbolic: bool = False
    """Whether the expert adds the poses when an order begins."""

    @property
    def parts(self) -> tuple[object, ...]:
        """Its policy."""
        return (self.policy,)

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return all valid orders of the policy for free robots."""
        drafts = [_Draft(team_input, self.symbolic) for team_input in inputs]
        while asked := [draft for draft in drafts if draft.goes_on]:
            visible = visible_to(self.policy, [draft.as_if_done() for draft in asked])
            answers = self.policy.act(visible)
            for draft, decision in zip(asked, answers, strict=True):
                draft.take(decision)
        return [
            Orders(tuple(draft.decisions), efforts=tuple(draft.efforts))
            for draft in drafts
        ]


class _Draft:
    """Orders for one team, under construction."""

    def __init__(self, team_input: TeamInput, symbolic: bool) -> None:
        self._input, self._symbolic = team_input, symbolic
        self._regions = (SHARED, *pair_regions(len(team_input.robots)))
        self._free = set(team_input.free)
        self._state: SymbolicState | None = None
        self.decisions: list[Decision] = []
        self.efforts: list[Effort] = []
        self.goes_on = bool(self._free)

    def as_if_done(self) -> PolicyInput:
        """Return the input as if all active orders had succeeded."""
        steps = [doing.subtask for doing in self._input.doing.values()]
        steps += [decision.subtask for decision in self.decisions]
        past = tuple(PastStep(self._input.view, subtask) for subtask in steps)
        return self._input.with_past((*self._input.past, *past))

    def take(self, decision: Any) -> None:
        """Add a decision to the orders, or end the draft."""
        first = _is_quiet(self._input) and not self.decisions
        if first or (isinstance(decision, Decision) and self._is_valid(decision)):
            self.decisions.append(decision)
            ordered = isinstance(decision, Decision) and not decision.stops
            self._free -= {decision.subtask.robot} if ordered else self._free
        else:
            self._free.clear()
            effort = getattr(decision, "effort", None)
            self.efforts += [effort] if effort is not None else []
        self.goes_on = bool(self._free)

    def _is_valid(self, decision: Decision) -> bool:
        subtask = decision.subtask
        busy = [doing.subtask for doing in self._input.doing.values()]
        busy += [one.subtask for one in self.decisions]
        if decision.stops or decision.failed or subtask.robot not in self._free:
            return False
        past = self._input.past
        done = [one.subtask for one in past if one.outcome == Outcome.SUCCESS]
        if subtask in busy or subtask in done:
            return False
        if not self._symbolic:
            needs = any(predecessors((one, subtask), self._regions)[1] for one in busy)
            return decision.grounded is not None and not needs
        return self._can_be_grounded(decision)

    def _can_be_grounded(self, decision: Decision) -> bool:
        """Return whether the expert can ground it; True for inputs of other policies.

        The effect of the sub-task is applied to the expected state.
        """
        team_input = self._input
        if not isinstance(team_input, TeamOracleInput):
            return True
        team = team_input.team
        if self._state is None:
            now = team.observe()
            self._state = team.expected(now, team.settled(now))
            for one in self.decisions:
                found = ground_or_refuse(one.subtask, self._state, team.grounder)
                if isinstance(found, GroundedOption):
                    self._state = found.after
        found = ground_or_refuse(decision.subtask, self._state, team.grounder)
        if not isinstance(found, GroundedOption):
            return False
        self._state = found.after
        return True


def _is_quiet(team_input: TeamInput) -> bool:
    """Return whether no robot is working and all are free."""
    return len(team_input.free) == len(team_input.robots)


def _visible_to(policy: TeamPolicy, inputs: Sequence[TeamInput]) -> list[TeamInput]:
    """Return inputs for a policy, with privileged state only for oracles."""
    return [one for one in visible_to(policy, inputs) if isinstance(one, TeamInput)]
