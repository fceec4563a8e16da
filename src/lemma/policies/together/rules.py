"""Rule-based team policies, all privileged: the expert's plan, reach, random."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

from lemma.core.errors import InvalidConfigError
from lemma.env.episode import Episode
from lemma.env.team.orders import PAUSE_S
from lemma.env.team.valid_orders import valid_options
from lemma.expert.timing import Aim
from lemma.motion.outcome import Outcome
from lemma.planning.grounding import GroundedOption, ground_or_refuse
from lemma.planning.planner import candidates, find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Decision, Oracle
from lemma.policies.oracle import refusal_words
from lemma.policies.together.interfaces import (
    Orders,
    TeamInput,
    TeamOracleInput,
    TeamPolicy,
)
from lemma.tasks.subtask import STOP, SubTask
from lemma.tasks.teams.dependencies import predecessors

_STOP = Orders((Decision(STOP, None),))
_MOST_PLANS = 4


def truth_of(team_input: TeamInput) -> TeamOracleInput:
    """Return an input as an oracle's input.

    Raises:
        InvalidConfigError: It is no :class:`TeamOracleInput`.
    """
    if not isinstance(team_input, TeamOracleInput):
        raise InvalidConfigError(
            "An oracle needs privileged state, which these inputs lack. Pass "
            "TeamOracleInput."
        )
    return team_input


def _expected(team_input: TeamOracleInput) -> SymbolicState:
    """Return the expected state after all active orders."""
    now = team_input.team.observe()
    return team_input.team.expected(now, team_input.team.settled(now))


def _is_at_work(team_input: TeamInput) -> bool:
    """Return whether a robot has an order, or is not free again after one."""
    return len(team_input.free) < len(team_input.robots)


def _ordered(subtasks: Sequence[SubTask]) -> Orders:
    return Orders(tuple(Decision(subtask, None) for subtask in subtasks))


@dataclass
class _Plan:
    """The expert's plan for an episode, and its progress."""

    steps: tuple[SubTask, ...] = ()
    todo: list[int] = field(default_factory=list)
    needs: tuple[dict[int, str], ...] = ()
    made: int = 0
    failures: int = 0
    aim: Aim | None = None
    """Tells when a step must wait for its time."""


@dataclass(frozen=True)
class OracleTeam(Oracle):
    """Executes the expert's plan with all robots at once.

    Each free robot gets the first of its sub-tasks whose dependencies have all had
    their effect, once it is due, as in :mod:`lemma.expert.together`. After a failure
    the working robots finish, and then there is a new plan, up to four in total.
    """

    _plans: WeakKeyDictionary[Episode, _Plan] = field(
        default_factory=WeakKeyDictionary, repr=False
    )

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return the next orders of each episode's plan."""
        return [self._act(truth_of(team_input)) for team_input in inputs]

    def _act(self, team_input: TeamOracleInput) -> Orders:
        episode, team = team_input.episode, team_input.team
        plan = self._plans.setdefault(episode, _Plan())
        failures = sum(step.outcome != Outcome.SUCCESS for step in team_input.past)
        idle = not team_input.doing
        if failures > plan.failures:
            plan.todo.clear()
        if idle and not plan.todo:
            goal, scene = episode.instance.goal, episode.simulation.scene
            done = plan.made == _MOST_PLANS or goal.progress(scene) == 1.0
            found = None
            if not done:
                found = find_plan(team.observe(), goal, team.grounder)
            if found is None or not found.subtasks:
                why = "" if plan.made or done else refusal_words(episode)
                return Orders((Decision(STOP, None, why),))
            plan.steps, plan.made = found.subtasks, plan.made + 1
            plan.todo, plan.failures = list(range(len(plan.steps))), failures
            regions, rule = tuple(episode.instance.scene.regions), goal.rule
            plan.needs = predecessors(plan.steps, regions, rule)
            plan.aim = Aim(team, plan.steps, plan.needs)
        return _ordered(_take(plan, team_input))


def _take(plan: _Plan, team_input: TeamOracleInput) -> list[SubTask]:
    """Remove and return the steps that can begin now, at most one per free robot."""
    settled = team_input.team.settled(team_input.team.observe())
    doing = team_input.doing
    begun = {
        k: each.since_s
        for k, one in enumerate(plan.steps)
        for each in doing.values()
        if one == each.subtask and k not in plan.todo
    }
    busy = {each.subtask for name, each in doing.items() if name not in settled}
    missing = {*plan.todo, *(k for k, one in enumerate(plan.steps) if one in busy)}
    have, found = {*range(len(plan.steps))} - missing, []
    for robot in team_input.free:
        mine = (k for k in plan.todo if plan.steps[k].robot == robot)
        k = next((k for k in mine if not plan.needs[k].keys() & missing), None)
        times = (team_input.time_s, begun, have, PAUSE_S)
        if k is not None and (plan.aim is None or plan.aim.is_due(k, *times)):
            found.append(plan.steps[k])
            plan.todo.remove(k)
    return found


@dataclass(frozen=True)
class GreedyReachTeam(Oracle):
    """Each free robot takes the first useful valid order.

    An order is useful if it serves a pair of the goal that will not hold after all
    active orders, and if it has not been done before. Orders that make a pair hold come
    first. The team stops if no robot is working and no order is useful.
    """

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return an order for each free robot that has a useful one."""
        return [self._act(truth_of(team_input)) for team_input in inputs]

    def _act(self, team_input: TeamOracleInput) -> Orders:
        goal, state = team_input.episode.instance.goal, _expected(team_input)
        if any(name in state.fallen for name in goal.entities):
            return Orders() if _is_at_work(team_input) else _STOP
        done = {s.subtask for s in team_input.past if s.outcome == Outcome.SUCCESS}
        done |= {doing.subtask for doing in team_input.doing.values()}
        grounder = team_input.team.grounder
        orders, robots = list[SubTask](), tuple(grounder.robots)
        for robot in team_input.free:
            useful = [
                option
                for subtask in candidates(state, goal, robots, grounder)
                if subtask.robot == robot
                and subtask not in done
                and isinstance(
                    option := ground_or_refuse(subtask, state, grounder),
                    GroundedOption,
                )
            ]
            held = sum(state.has(top, bottom) for top, bottom in goal.pairs)
            best = next(
                (
                    option
                    for option in useful
                    if sum(option.after.has(*pair) for pair in goal.pairs) > held
                ),
                next(iter(useful), None),
            )
            if best is not None:
                orders.append(best.subtask)
                state = best.after
        return _ordered(orders) if orders or _is_at_work(team_input) else _STOP


@dataclass(frozen=True)
class RandomValidTeam(Oracle):
    """Each free robot takes a random valid order, including ``stop``."""

    seed: int = 0

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return an order for each free robot that has a valid one."""
        return [self._act(truth_of(team_input)) for team_input in inputs]

    def _act(self, team_input: TeamOracleInput) -> Orders:
        state, orders = _expected(team_input), list[SubTask]()
        for robot in team_input.free:
            options = list(valid_options(robot, state, team_input.team.grounder))
            if not options:
                continue
            number = self._below(len(options) + 1, team_input, robot)
            if number == len(options):
                return _STOP
            orders.append(options[number].subtask)
            state = options[number].after
        return _ordered(orders) if orders or _is_at_work(team_input) else _STOP

    def _below(self, count: int, team_input: TeamOracleInput, robot: str) -> int:
        """Return a number from 0 to ``count`` - 1, the same on every machine."""
        key = f"random-valid {self.seed} {team_input.episode.instance.key}"
        key += f" {len(team_input.past)} {team_input.time_s:.3f} {robot} {count}"
        digest = hashlib.sha256(key.encode()).digest()
        return int.from_bytes(digest[:16]) % count


def _seeded(text: str) -> RandomValidTeam:
    if text and not text.isdecimal():
        raise InvalidConfigError(
            f"random-valid:{text} is no team. Valid after the colon: a whole number "
            "from 0."
        )
    return RandomValidTeam(int(text or 0))


TEAM_RULES: dict[str, Callable[[str], TeamPolicy]] = {
    "oracle": lambda text: OracleTeam(),
    "greedy-reach": lambda text: GreedyReachTeam(),
    "random-valid": _seeded,
}
"""Factories of rules by the name before the colon; the argument is the text after it.
With ``acting="together"`` they replace the sequential policies of the same names."""
