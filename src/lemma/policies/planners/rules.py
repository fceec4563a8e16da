"""Planners without a model, to compare language models with.

All of them get the simulation's state. Chance comes from hashes of the instance and the
number of the decision, so that it is the same on every machine and in every order.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from lemma.core.errors import InvalidConfigError
from lemma.env.episode import Episode
from lemma.expert.grounding import GeometricGrounder, GroundedOption
from lemma.expert.planner import candidates
from lemma.expert.symbolic_state import SymbolicState
from lemma.motion.outcome import Outcome
from lemma.policies.interfaces import Oracle, PolicyInput
from lemma.policies.oracle import OraclePlanner, truth_of
from lemma.policies.planners.answers import AnswerFormat
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import STOP, SubTask


class _Draws:
    """Numbers of one decision."""

    def __init__(self, what: str, seed: int, given: PolicyInput) -> None:
        key = truth_of(given).instance.key
        self._key = f"{what} {seed} {key} {len(given.past)}"

    def below(self, count: int) -> int:
        """Return a whole number from 0 to ``count`` - 1."""
        digest = hashlib.sha256(f"{self._key} {count}".encode()).digest()
        return int.from_bytes(digest[:16]) % count

    def share(self) -> float:
        """Return a number from 0 to 1, without 1."""
        digest = hashlib.sha256(f"{self._key} share".encode()).digest()
        return int.from_bytes(digest[:6]) / 2**48


def _valid_answers(episode: Episode) -> list[SubTask]:
    """Return every valid answer at the present table."""
    spec = episode.simulation.scene.spec
    on_table = (name for name in spec.object_names if name not in episode.fallen)
    return AnswerFormat(spec.robot_names, tuple(on_table)).every_subtask()


@dataclass(frozen=True)
class RandomValidPlanner(Oracle):
    """Answers any possible sub-task, ``stop`` among them."""

    seed: int = 0

    blind = True
    reads_outcomes = True

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        found = []
        for given in inputs:
            valid = _valid_answers(truth_of(given))
            draws = _Draws("random-valid", self.seed, given)
            found.append(valid[draws.below(len(valid))])
        return found


@dataclass(frozen=True)
class NoisyOraclePlanner(Oracle):
    """Answers as the expert does, but errs with a probability.

    A wrong answer is any other possible sub-task.
    """

    error_rate: float = 0.1
    expert: OraclePlanner = field(default_factory=OraclePlanner)

    blind = True
    reads_outcomes = True

    def __post_init__(self) -> None:
        """Check the rate."""
        if not 0.0 <= self.error_rate <= 1.0:
            raise InvalidConfigError(
                f"An oracle that errs with probability {self.error_rate}? Valid: from "
                "0 to 1, as in noisy-oracle:0.1."
            )

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        return [
            self._plan(given, right)
            for given, right in zip(inputs, self.expert.plan(inputs), strict=True)
        ]

    def _plan(self, given: PolicyInput, right: SubTask) -> SubTask:
        draws = _Draws("noisy-oracle", 0, given)
        if draws.share() >= self.error_rate:
            return right
        others = [each for each in _valid_answers(truth_of(given)) if each != right]
        return others[draws.below(len(others))]


@dataclass(frozen=True)
class GreedyReachPlanner(Oracle):
    """Looks one sub-task ahead, and goes by reach.

    Among the sub-tasks that a robot can do now about the pairs that do not hold, it
    takes one that makes a pair hold; else the one farthest inside of reach. It repeats
    no sub-task that has succeeded, and stops where none is left.
    """

    blind = True
    reads_outcomes = True

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        return [self._plan(given) for given in inputs]

    def _plan(self, given: PolicyInput) -> SubTask:
        episode = truth_of(given)
        goal = episode.instance.goal
        now = SymbolicState.observe(episode.simulation.scene)
        if any(name in now.fallen for name in goal.entities):
            return STOP
        geometry = GeometricGrounder(now.spec)
        done = {s.subtask for s in given.past if s.outcome == Outcome.SUCCESS}
        options = [
            option
            for subtask in candidates(now, goal, tuple(geometry.robots), geometry)
            if subtask not in done
            and (option := geometry.ground(subtask, now)) is not None
        ]
        if not options:
            return STOP
        return max(options, key=lambda option: _worth(option, goal)).subtask


def _worth(option: GroundedOption, goal: Goal) -> tuple[int, float]:
    return _held(goal, option.after), option.quality


def _held(goal: Goal, state: SymbolicState) -> int:
    return sum(state.supports[on.top] == on.bottom for on in goal.conjuncts)
