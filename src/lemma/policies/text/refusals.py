"""Sentences that are no order for the table, made by rules: ``data/refusals.toml``.

A reader that is only ever shown orders takes everything for one. So it is also shown
questions, stories, other verbs and relations, denials and things that are not there,
each with the reason why it is none; and orders that look like them: contrasts ("not on
the blue one") and plain ones.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from lemma.policies.text.paraphrase import CHANCES, noisy
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import entity_named
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.template import GoalPairs

REASONS: Mapping[str, str] = {
    "absent": "It names a thing or a color that I do not know.",
    "relation": "I can only put things on things, not beside or between them.",
    "verb": "I can only put things on things, and nothing else.",
    "removal": "I can only put things on things, not lift them or take them off.",
    "question": "That is a question.",
    "story": "That tells what was or will be, and asks for nothing.",
    "negation": "It says what shall not be, or only under a condition. Say what shall "
    "be.",
    "impossible": "Things like that cannot be done here.",
    "vague": "It does not say which thing shall lie on which. Name both by color.",
    "talk": "It asks for nothing on the table.",
}
"""Why a sentence is no order, by the names of the reasons."""
REASON_NAMES = tuple(REASONS)
_DRAWN = (*REASON_NAMES, "negation", "absent")
"""Reasons to draw from; the hardest ones, by the lines kept, are there twice."""
_KEPT = 8
"""Every so many lines one is kept for choosing the temperature."""
_ORDERS = 0.45
"""Share of orders among what is drawn."""
_SLOT = re.compile(r"\{(\w+)\}")
_RULE = re.compile(r"<(\w+)>")
_CHOICE = re.compile(r"\(([^()]*)\)")
_FORMS = (*("the {c} {n}",) * 6, "{c} {n}", "the {n} that is {c}", "that {c} {n}")
_BARE = ("the {c} one", "{c}", "the {c}")


@dataclass(frozen=True)
class RefusalBank:
    """Sentences by the reason why they are refused, and orders that look like them."""

    refused: Mapping[str, Sequence[str]]
    orders: Mapping[str, Sequence[str]]
    """By what they look like: ``contrast``, ``plain`` or ``own``."""
    colors: Sequence[str]
    """Words for colors that nothing has."""
    things: Sequence[str]
    """Words for things that are not there."""
    rules: Mapping[str, Sequence[str]]
    """Texts in place of ``<name>``."""

    @classmethod
    def of(cls, source: Mapping[str, Any]) -> "RefusalBank":
        """Return the bank that a file describes."""
        words = source["words"]
        return cls(
            source["refused"],
            source["orders"],
            words["colors"],
            words["things"],
            words,
        )

    def parted(self, *, kept: bool) -> "RefusalBank":
        """Return the lines for training, or those kept for choosing the temperature."""

        def part(lines: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
            return {
                name: [t for i, t in enumerate(of) if (i % _KEPT == _KEPT - 1) is kept]
                for name, of in lines.items()
            }

        return replace(self, refused=part(self.refused), orders=part(self.orders))

    def render(self, line: str, rng: np.random.Generator, goal: GoalPairs = ()) -> str:
        """Return a line with its rules, choices and slots filled in.

        Args:
            line: Of this bank.
            rng: Where all draws come from.
            goal: The pairs whose things fill the slots of an order.
        """
        while found := _CHOICE.search(line):
            start, end = found.span()
            line = line[:start] + _one(found[1].split("|"), rng) + line[end:]
        line = _RULE.sub(lambda found: _one(self.rules[found[1]], rng), line)
        slots = _slots(rng, goal) | {
            "x": _one(self.colors, rng),
            "y": _one(self.things, rng),
        }
        return _SLOT.sub(lambda found: slots[found[1]], line)

    def draw(
        self, rng: np.random.Generator, *, plain: bool = False
    ) -> tuple[str, GoalPairs, int]:
        """Return a sentence, its goal, and the number of the reason why it has none.

        The number is -1 if it has one.

        Args:
            rng: Where all draws come from.
            plain: Whether the sentence is left without errors.
        """
        goal: GoalPairs = ()
        if rng.random() < _ORDERS:
            number, line = -1, _one(self.orders[_one(tuple(self.orders), rng)], rng)
            goal = goal_for(line, rng)
        else:
            reason = _one(_DRAWN, rng)
            number, line = REASON_NAMES.index(reason), _one(self.refused[reason], rng)
        text = self.render(line, rng, goal)
        return (text if plain else noisy(text, rng, _CHANCES)), goal, number


# Hardly any word is left out or exchanged: "not" and "off" are what matters here.
_CHANCES = {**CHANCES, "swapped": 0.05, "left_out": 0.0, "strange": 0.01}


@cache
def refusal_bank(*, kept: bool = False) -> RefusalBank:
    """Return the bank that comes with the package.

    Args:
        kept: Whether the lines kept for choosing the temperature are returned, instead
            of those for training.
    """
    source = files("lemma.policies.text") / "data" / "refusals.toml"
    found = tomllib.loads(source.read_text(encoding="utf-8"))
    return RefusalBank.of(found).parted(kept=kept)


# For the reason in words alone; what is refused does not depend on it.
_STRANGE = (
    *("orange", "purple", "violet", "brown", "black", "grey", "gray", "cyan", "gold"),
    *("magenta", "turquoise", "teal", "silver", "golden", "beige", "lilac", "maroon"),
)
_UNKNOWN = re.compile(
    rf"\b({'|'.join(_STRANGE)})"
    r"(?: (cube|block|box|brick|pad|circle|target|mat|disc))?\b"
)


def unknown_things(text: str) -> str:
    """Return the first thing of a color that nothing has, such as ``"purple cube"``.

    Args:
        text: A sentence that was refused; the result is empty if it names none.
    """
    found = _UNKNOWN.search(text.lower())
    return f"{found[1]} {found[2] or 'thing'}" if found else ""


def goal_for(line: str, rng: np.random.Generator) -> GoalPairs:
    """Return a goal with as many pairs as an order has: cubes on pads or on cubes."""
    cubes, pads = (rng.permutation(list(BENCHMARK_COLORS)).tolist() for _ in range(2))
    count = 2 if "{t2}" in line else 1
    return tuple(
        (f"{cubes[i]}_cube", f"{pads[i]}_pad")
        if rng.random() < 0.5
        else (f"{cubes[i]}_cube", f"{cubes[count + i]}_cube")
        for i in range(count)
    )


def _one(options: Sequence[str], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _slots(rng: np.random.Generator, goal: GoalPairs) -> dict[str, str]:
    """Return a text for each slot; things of one kind differ in their colors."""
    cubes = rng.permutation(list(BENCHMARK_COLORS)).tolist()
    pads = rng.permutation(list(BENCHMARK_COLORS)).tolist()
    found = {f"c{i}": _named(c, CUBE.nouns, rng) for i, c in enumerate(cubes, 1)}
    found |= {f"p{i}": _named(c, PAD.nouns, rng) for i, c in enumerate(pads, 1)}
    found |= {"k1": cubes[0], "k2": cubes[1]}
    found["s"] = found["c4" if rng.random() < 0.5 else "p2"]
    pairs = [(entity_named(top), entity_named(bottom)) for top, bottom in goal]
    for number, (upper, lower) in zip(("", "2"), pairs, strict=False):
        found[f"t{number}"] = _named(upper.color, upper.kind.nouns, rng)
        found[f"b{number}"] = _named(lower.color, lower.kind.nouns, rng)
    if len(pairs) == 1:
        ((upper, lower),) = pairs
        named = {upper.color, lower.color}
        other, another = [color for color in cubes if color not in named][:2]
        found["u"] = _named(other, upper.kind.nouns, rng)
        found["a"] = _named(another, lower.kind.nouns, rng)
        if rng.random() < 0.3:
            # "Not on the blue one."
            found["a"] = _one(_BARE, rng).format(c=another)
    return found


def _named(color: str, nouns: Sequence[str], rng: np.random.Generator) -> str:
    return _one(_FORMS, rng).format(c=color, n=_one(nouns, rng))
