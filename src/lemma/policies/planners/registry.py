"""Planners by name: what ships, and what users add."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.policies.interfaces import Planner
from lemma.policies.planners.chat import ChatOptions
from lemma.policies.planners.language_model import LanguageModelPlanner
from lemma.policies.planners.rules import (
    GreedyReachPlanner,
    NoisyOraclePlanner,
    RandomValidPlanner,
)

NO_CHAT = ChatOptions()
"""Options of planners that ask nobody."""


@dataclass(frozen=True)
class PlannerRecord:
    """How a planner of a name is made.

    The planner says by its type whether it needs the truth
    (:class:`lemma.policies.interfaces.Oracle`), and by attributes whether it reads
    outcomes (``reads_outcomes``), needs no images (``blind``), looks at those of the
    cameras (``cameras``), or has something to say of itself in ``about.json``
    (``about``).
    """

    make: Callable[[str, ChatOptions, float], Planner]
    """Makes it of what follows the colon of its name, if anything does; of how language
    models are asked; and of the time that a request may take [s]. It is called often:
    what takes long should wait until the planner is asked."""
    asks: bool = False
    """Whether it makes use of how language models are asked."""


PLANNERS: Registry[PlannerRecord] = Registry("planner", PlannerRecord)
"""Every planner that is no model of ours, by the name before the colon."""


def is_planner(part: str) -> bool:
    """Whether a part of a policy's name means a planner of :data:`PLANNERS`."""
    return "://" not in part and part.partition(":")[0] in PLANNERS


def asks_model(part: str) -> bool:
    """Whether a part of a policy's name means a planner that asks a language model."""
    return is_planner(part) and PLANNERS[part.partition(":")[0]].asks


def make_planner(
    part: str, options: ChatOptions | None = None, timeout_s: float = 0.0
) -> Any:
    """Return the planner that a part of a policy's name means.

    Args:
        part: ``"greedy-reach"``, ``"noisy-oracle:0.2"``, ``"llm:MODEL"``.
        options: How language models are asked.
        timeout_s: For a request [s].

    Raises:
        LemmaError: There is none of that name, or it cannot be made so.
    """
    name, _, argument = part.partition(":")
    return PLANNERS[name].make(argument, options or NO_CHAT, timeout_s)


def _random_valid(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
    if argument and not argument.isdecimal():
        raise InvalidConfigError(
            f"random-valid:{argument} has no seed. Valid: a whole number from 0, as in "
            "random-valid:1."
        )
    return RandomValidPlanner(int(argument or 0))


def _greedy_reach(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
    if argument:
        raise InvalidConfigError(f"greedy-reach takes nothing, and not {argument!r}.")
    return GreedyReachPlanner()


def _noisy_oracle(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
    try:
        rate = float(argument) if argument else NoisyOraclePlanner.error_rate
    except ValueError:
        raise InvalidConfigError(
            f"noisy-oracle:{argument} has no probability. Valid: a number from 0 to 1, "
            "as in noisy-oracle:0.1."
        ) from None
    return NoisyOraclePlanner(rate)


def _language_model(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
    return LanguageModelPlanner(argument, options, timeout_s)


PLANNERS.add("random-valid", PlannerRecord(_random_valid))
PLANNERS.add("greedy-reach", PlannerRecord(_greedy_reach))
PLANNERS.add("noisy-oracle", PlannerRecord(_noisy_oracle))
PLANNERS.add("llm", PlannerRecord(_language_model, asks=True))
