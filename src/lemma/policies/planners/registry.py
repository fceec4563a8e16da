"""Planners by name: those that ship, and those of plugins."""

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

    A planner that needs the simulation's state is derived from
    :class:`lemma.policies.interfaces.Oracle`. Attributes say whether it reads outcomes
    (``reads_outcomes``), needs no images (``blind``) or the images of the cameras
    (``cameras``); ``about`` is written into ``about.json``.
    """

    make: Callable[[str, ChatOptions, float], Planner]
    """Makes it from the text after the colon of its name, the options of language
    models, and the time for a request [s]. It is called often, so slow work, such as
    loading weights, should wait until the planner is asked."""
    asks: bool = False
    """Whether it uses the options of language models."""


PLANNERS: Registry[PlannerRecord] = Registry("planner", PlannerRecord)
"""Every planner without weights of ours, by the name before the colon."""


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
    name, colon, argument = part.partition(":")
    if colon and not argument and not PLANNERS[name].asks:
        raise InvalidConfigError(
            f"{part!r} is no planner: nothing follows the colon. Valid: {name}."
        )
    return PLANNERS[name].make(argument, options or NO_CHAT, timeout_s)


def _rule(
    name: str, make: Callable[..., Planner], number: Callable[[str], float], valid: str
) -> PlannerRecord:
    """Return a rule whose name may end with a number."""

    def made(argument: str, options: ChatOptions, timeout_s: float) -> Planner:
        try:
            numbers = [number(argument)] if argument else []
        except ValueError:
            raise InvalidConfigError(
                f"{name}:{argument} is no planner. Valid after the colon: {valid}."
            ) from None
        return make(*numbers)

    return PlannerRecord(made)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise ValueError
    return int(text)


def _none(text: str) -> int:
    raise ValueError


for _name, _make, _number, _valid in (
    ("random-valid", RandomValidPlanner, _seed, "a whole number from 0"),
    ("noisy-oracle", NoisyOraclePlanner, float, "a probability, such as 0.1"),
    ("greedy-reach", GreedyReachPlanner, _none, "nothing"),
):
    PLANNERS.add(_name, _rule(_name, _make, _number, _valid))
PLANNERS.add(
    "llm",
    PlannerRecord(lambda name, *asked: LanguageModelPlanner(name, *asked), asks=True),
)
