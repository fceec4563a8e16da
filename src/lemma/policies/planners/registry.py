"""Planners by name: those of the package and of plugins.

Rules are baselines without a model for language models. All of them get the
simulation's state. Their random numbers are hashes of the instance and the number of
the decision, so they are the same on every machine and in every order.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.env.episode import Episode
from lemma.motion.outcome import Outcome
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.planner import candidates
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import Oracle, Planner, PolicyInput
from lemma.policies.oracle import OraclePlanner, truth_of
from lemma.policies.planners.answers import AnswerFormat
from lemma.policies.planners.chat import ChatOptions
from lemma.policies.planners.language_model import LanguageModelPlanner
from lemma.tasks.goal import Goal
from lemma.tasks.subtask import STOP, SubTask

NO_CHAT = ChatOptions()
"""Options of planners that use no language model."""


@dataclass(frozen=True)
class PlannerRecord:
    """How to create a planner from its name.

    A planner that needs the simulation's state is derived from
    :class:`lemma.policies.interfaces.Oracle`. Boolean attributes state whether it reads
    outcomes (``reads_outcomes``), needs no images (``blind``) or needs the images of
    the cameras (``cameras``). The attribute ``about`` is written into ``about.json``.
    """

    make: Callable[[str, ChatOptions, float], Planner]
    """Creates the planner from the text after the colon of its name, the options of
    language models, and the time limit of a request [s]. It is called often, so slow
    work, such as loading weights, should wait until the first plan."""
    asks: bool = False
    """Whether it uses the options of language models."""


PLANNERS: Registry[PlannerRecord] = Registry("planner", PlannerRecord)
"""Planners without trained weights, by the name before the colon."""


def is_planner(part: str) -> bool:
    """Return whether a part of a policy's name is a planner of :data:`PLANNERS`."""
    return "://" not in part and part.partition(":")[0] in PLANNERS


def asks_model(part: str) -> bool:
    """Return whether a part of a policy's name is a planner with a language model."""
    return is_planner(part) and PLANNERS[part.partition(":")[0]].asks


def make_planner(
    part: str, options: ChatOptions | None = None, timeout_s: float = 0.0
) -> Any:
    """Create a planner from its part of a policy's name.

    Args:
        part: ``"greedy-reach"``, ``"noisy-oracle:0.2"``, ``"llm:MODEL"``.
        options: Options of requests to language models.
        timeout_s: Time limit of a request [s].

    Raises:
        LemmaError: There is no planner of that name, or the options are invalid.
    """
    name, colon, argument = part.partition(":")
    if colon and not argument and not PLANNERS[name].asks:
        raise InvalidConfigError(
            f"{part!r} is no planner: nothing follows the colon. Valid: {name}."
        )
    return PLANNERS[name].make(argument, options or NO_CHAT, timeout_s)


class _Draws:
    """Random numbers of one decision, from hashes."""

    def __init__(self, what: str, seed: int, policy_input: PolicyInput) -> None:
        key = truth_of(policy_input).instance.key
        self._key = f"{what} {seed} {key} {len(policy_input.past)}"

    def below(self, count: int) -> int:
        """Return a whole number from 0 to ``count`` - 1."""
        digest = hashlib.sha256(f"{self._key} {count}".encode()).digest()
        return int.from_bytes(digest[:16]) % count

    def share(self) -> float:
        """Return a number in [0, 1)."""
        digest = hashlib.sha256(f"{self._key} share".encode()).digest()
        return int.from_bytes(digest[:6]) / 2**48


def _valid_answers(episode: Episode) -> list[SubTask]:
    """Return every valid answer in the present scene."""
    spec = episode.simulation.scene.spec
    on_table = (name for name in spec.object_names if name not in episode.fallen)
    return AnswerFormat(spec.robot_names, tuple(on_table)).every_subtask()


@dataclass(frozen=True)
class RandomValidPlanner(Oracle):
    """Chooses a random possible sub-task or ``stop``."""

    seed: int = 0

    blind = True
    reads_outcomes = True

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        found = []
        for policy_input in inputs:
            valid = _valid_answers(truth_of(policy_input))
            draws = _Draws("random-valid", self.seed, policy_input)
            found.append(valid[draws.below(len(valid))])
        return found


@dataclass(frozen=True)
class NoisyOraclePlanner(Oracle):
    """The expert's planner with a probability of error.

    A wrong decision is a random other possible sub-task.
    """

    error_rate: float = 0.1
    expert: OraclePlanner = field(default_factory=OraclePlanner)

    blind = True
    reads_outcomes = True

    def __post_init__(self) -> None:
        """Check the rate."""
        if not 0.0 <= self.error_rate <= 1.0:
            raise InvalidConfigError(
                f"The error rate of the noisy oracle is {self.error_rate}. Valid: from "
                "0 to 1, as in noisy-oracle:0.1."
            )

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        return [
            self._plan(policy_input, right)
            for policy_input, right in zip(
                inputs, self.expert.plan(inputs), strict=True
            )
        ]

    def _plan(self, policy_input: PolicyInput, right: SubTask) -> SubTask:
        draws = _Draws("noisy-oracle", 0, policy_input)
        if draws.share() >= self.error_rate:
            return right
        others = [
            each for each in _valid_answers(truth_of(policy_input)) if each != right
        ]
        return others[draws.below(len(others))]


@dataclass(frozen=True)
class GreedyReachPlanner(Oracle):
    """A greedy planner with a horizon of one sub-task.

    It considers the sub-tasks that a robot can do now for pairs that do not hold. It
    prefers one that makes a pair hold; otherwise it takes the one with the largest
    reach margin. It repeats no successful sub-task, and stops if none is left.
    """

    blind = True
    reads_outcomes = True

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return a sub-task of each episode."""
        return [self._plan(policy_input) for policy_input in inputs]

    def _plan(self, policy_input: PolicyInput) -> SubTask:
        episode = truth_of(policy_input)
        goal = episode.instance.goal
        now = SymbolicState.observe(episode.simulation.scene)
        fallen = any(name in now.fallen for name in goal.entities)
        # A symbolic state does not represent goals of hands, so check the scene.
        if fallen or goal.progress(episode.simulation.scene) == 1.0:
            return STOP
        geometry = GeometricGrounder(now.spec)
        done = {s.subtask for s in policy_input.past if s.outcome == Outcome.SUCCESS}
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
    return sum(state.has(top, bottom) for top, bottom in goal.pairs)


def _add_rule(
    name: str, make: Callable[..., Planner], number: Callable[[str], float], valid: str
) -> None:
    """Register a rule whose name may end with a number."""

    def made(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
        try:
            numbers = [number(argument)] if argument else []
        except ValueError:
            raise InvalidConfigError(
                f"{name}:{argument} is no planner. Valid after the colon: {valid}."
            ) from None
        return make(*numbers)

    PLANNERS.add(name, PlannerRecord(made))


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise ValueError
    return int(text)


def _none(text: str) -> int:
    raise ValueError


_add_rule("random-valid", RandomValidPlanner, _seed, "a whole number from 0")
_add_rule("noisy-oracle", NoisyOraclePlanner, float, "a probability, such as 0.1")
_add_rule("greedy-reach", GreedyReachPlanner, _none, "nothing")
PLANNERS.add(
    "llm",
    PlannerRecord(lambda name, *asked: LanguageModelPlanner(name, *asked), asks=True),
)
