"""Sentences that are no order for the table, made by rules: ``data/refusals.toml``.

A reader that is only ever shown orders takes everything for one. So it is also shown
questions, stories, other verbs and relations, denials and things that are not there,
each with the reason why it is none; and contrasts ("not on the blue one"), which are
orders although they deny something.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
_CONTRASTS = 0.2
"""Share of contrasts among what is drawn."""
_COLORS_NAMED = re.compile(r"\b(?:" + "|".join(BENCHMARK_COLORS) + r")\b")
_SLOT = re.compile(r"\{(\w+)\}")
_RULE = re.compile(r"<(\w+)>")
_CHOICE = re.compile(r"\(([^()]*)\)")
_FORMS = (*("the {c} {n}",) * 6, "{c} {n}", "the {n} that is {c}", "that {c} {n}")
_BARE = ("the {c} one", "{c}", "the {c}")


@dataclass(frozen=True)
class RefusalBank:
    """Sentences by the reason why they are refused, and contrasts."""

    refused: Mapping[str, Sequence[str]]
    contrast: Mapping[str, Sequence[str]]
    colors: Sequence[str]
    """Words for colors that nothing has."""
    things: Sequence[str]
    """Words for things that are not there."""
    rules: Mapping[str, Sequence[str]]
    """Texts in place of ``<name>``."""

    @classmethod
    def of(cls, source: Mapping[str, Any]) -> "RefusalBank":
        """Return the bank that a file describes."""
        rules = dict(source.get("words", source))
        return cls(
            source["refused"],
            source["contrast"],
            rules["colors"],
            rules["things"],
            rules,
        )

    def parted(self, *, kept: bool) -> "RefusalBank":
        """Return the lines for training, or those kept for choosing the temperature."""

        def part(
            lines: Mapping[str, Sequence[str]],
        ) -> dict[str, list[str]]:
            return {
                name: [
                    line
                    for i, line in enumerate(texts)
                    if (i % _KEPT == _KEPT - 1) is kept
                ]
                for name, texts in lines.items()
            }

        return RefusalBank(
            part(self.refused),
            part(self.contrast),
            self.colors,
            self.things,
            self.rules,
        )

    def render(self, line: str, rng: np.random.Generator, goal: GoalPairs = ()) -> str:
        """Return a line with its rules, choices and slots filled in.

        Args:
            line: Of this bank.
            rng: Where all draws come from.
            goal: One pair, whose things fill the slots of a contrast.
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
    ) -> tuple[str, GoalPairs, str]:
        """Return a sentence, and its goal or the reason why it has none.

        Args:
            rng: Where all draws come from.
            plain: Whether the sentence is left without errors.
        """
        goal: GoalPairs = ()
        if rng.random() < _CONTRASTS:
            reason, goal = "", _drawn_goal(rng)
            line = _one(self.contrast["one"], rng)
        else:
            reason = _one(_DRAWN, rng)
            line = _one(self.refused[reason], rng)
        text = self.render(line, rng, goal)
        return (text if plain else noisy(text, rng, _CHANCES)), goal, reason


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


_STRANGE = (
    *("orange", "purple", "violet", "brown", "black", "grey", "gray", "cyan", "gold"),
    *("magenta", "turquoise", "teal", "silver", "golden", "beige", "lilac", "maroon"),
)
_UNKNOWN = re.compile(
    rf"\b({'|'.join(_STRANGE)})"
    r"(?: (cube|block|box|brick|pad|circle|target|mat|disc))?\b"
)
_NOUN = "|".join(sorted({*CUBE.nouns, *PAD.nouns, "mat", "disc", "brick", "spot"}))
_SAME = r"(?:its|the|that|their) (?:very )?(?:own|same|very)(?: own)? colou?r"
_OWN = re.compile(
    rf"\bthe (?P<noun>{_NOUN})"
    rf" (?:(?:of|in|with|having) (?:{_SAME}|its colou?r)"
    r"|(?:that|which) (?:has|shares|matches) (?:its|the same)(?: own)? colou?r)"
    rf"|\b(?:the|its) (?:matching|same[- ]colou?red|like-colou?red) (?P<noun2>{_NOUN})",
    re.IGNORECASE,
)


def resolved(text: str) -> str:
    """Return a text in which "the pad of its own color" has the color's name.

    Only where one color is named in all, so that there is no doubt.
    """
    colors = set(_COLORS_NAMED.findall(text.lower()))
    if len(colors) != 1:
        return text
    color = colors.pop()
    return _OWN.sub(lambda m: f"the {color} {m['noun'] or m['noun2']}", text)


def unknown_things(text: str) -> str:
    """Return the first thing of a color that nothing has, such as ``"purple cube"``.

    Args:
        text: A sentence that was refused; the result is empty if it names none.
    """
    found = _UNKNOWN.search(text.lower())
    return f"{found[1]} {found[2] or 'thing'}" if found else ""


def _one(options: Sequence[str], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _drawn_goal(rng: np.random.Generator) -> GoalPairs:
    """Return a goal of one pair: a cube on a pad, or on another cube."""
    one, other = rng.permutation(list(BENCHMARK_COLORS))[:2].tolist()
    kind = "pad" if rng.random() < 0.5 else "cube"
    return ((f"{one}_cube", f"{other}_{kind}"),)


def _slots(rng: np.random.Generator, goal: GoalPairs) -> dict[str, str]:
    """Return a text for each slot; things of one kind differ in their colors."""
    cubes = rng.permutation(list(BENCHMARK_COLORS)).tolist()
    pads = rng.permutation(list(BENCHMARK_COLORS)).tolist()
    found = {f"c{i}": _named(c, CUBE.nouns, rng) for i, c in enumerate(cubes, 1)}
    found |= {f"p{i}": _named(c, PAD.nouns, rng) for i, c in enumerate(pads, 1)}
    found |= {"k1": cubes[0], "k2": cubes[1]}
    found["s"] = found["c4" if rng.random() < 0.5 else "p2"]
    for top, bottom in goal:
        upper, lower = entity_named(top), entity_named(bottom)
        named = {upper.color, lower.color}
        other, another = [color for color in cubes if color not in named][:2]
        found["t"] = _named(upper.color, upper.kind.nouns, rng)
        found["b"] = _named(lower.color, lower.kind.nouns, rng)
        found["u"] = _named(other, upper.kind.nouns, rng)
        found["a"] = _named(another, lower.kind.nouns, rng)
        if rng.random() < 0.3:
            # "Not on the blue one."
            found["a"] = _one(_BARE, rng).format(c=another)
    return found


def _named(color: str, nouns: Sequence[str], rng: np.random.Generator) -> str:
    return _one(_FORMS, rng).format(c=color, n=_one(nouns, rng))
