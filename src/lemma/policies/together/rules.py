"""Teams that act by a rule: the expert's plan, reach, or chance. All know the truth."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

from lemma.core.errors import InvalidConfigError
from lemma.env.episode import Episode
from lemma.env.team.valid_orders import valid_options
from lemma.motion.outcome import Outcome
from lemma.planning.grounding import GroundedOption, ground_or_refuse
from lemma.planning.planner import candidates, find_plan
from lemma.planning.schedule import predecessors
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

_STOP = Orders((Decision(STOP, None),))
_MOST_PLANS = 4


def truth_of(team_input: TeamInput) -> TeamOracleInput:
    """Return an input with the truth.

    Raises:
        InvalidConfigError: It comes without.
    """
    if not isinstance(team_input, TeamOracleInput):
        raise InvalidConfigError(
            "An oracle was asked, but the inputs come without the truth. Give it "
            "TeamOracleInput."
        )
    return team_input


def _expected(team_input: TeamOracleInput) -> SymbolicState:
    """Return the state that all that is under way will leave behind."""
    now = team_input.team.observe()
    return team_input.team.expected(now, team_input.team.settled(now))


def _is_at_work(team_input: TeamInput) -> bool:
    """Whether somebody has an order, or rests from one."""
    return len(team_input.free) < len(team_input.robots)


def _ordered(subtasks: Sequence[SubTask]) -> Orders:
    return Orders(tuple(Decision(subtask, None) for subtask in subtasks))


@dataclass
class _Plan:
    """The expert's plan for an episode, and what of it was ordered."""

    steps: tuple[SubTask, ...] = ()
    todo: list[int] = field(default_factory=list)
    made: int = 0
    failures: int = 0


@dataclass(frozen=True)
class OracleTeam(Oracle):
    """Orders the expert's plan, to all robots at once.

    Each free robot is ordered the first of its sub-tasks for which nothing is missing:
    all that it depends on has had its effect, as in :mod:`lemma.expert.together`. After
    a failure those at work finish, and then there is a new plan, up to four in all.
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
        return _ordered(_take(plan, team_input))


def _take(plan: _Plan, team_input: TeamOracleInput) -> list[SubTask]:
    """Return the steps of a plan that can begin now, one for each free robot."""
    instance = team_input.episode.instance
    regions = tuple(instance.scene.regions)
    needs = predecessors(plan.steps, regions, instance.goal.rule)
    settled = team_input.team.settled(team_input.team.observe())
    busy = {d.subtask for name, d in team_input.doing.items() if name not in settled}
    missing = {*plan.todo, *(k for k, one in enumerate(plan.steps) if one in busy)}
    found = []
    for robot in team_input.free:
        mine = (k for k in plan.todo if plan.steps[k].robot == robot)
        k = next((k for k in mine if not needs[k].keys() & missing), None)
        if k is not None:
            found.append(plan.steps[k])
            plan.todo.remove(k)
    return found


@dataclass(frozen=True)
class GreedyReachTeam(Oracle):
    """Each free robot takes the first useful valid order.

    Useful is what serves a pair of the goal that will not hold when all that is under
    way has had its effect, and has not been done before. An order that makes a pair
    hold comes first. The team stops where nobody is at work and nothing is useful.
    """

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return an order for each free robot that finds a useful one."""
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
    """Each free robot takes any valid order; ``stop`` is one of them."""

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
        """Return a number from 0 to ``count`` - 1: the same on every machine."""
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
"""Rules by the name before the colon, made of what is behind it. As policies that act
together they take the place of the sequential ones of these names."""
