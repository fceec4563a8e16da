"""A grammar that generates instructions for a goal: ``data/grammar.toml``.

The rules use roles, top and bottom. A verb, a preposition or its inverse, a passive, or
the order of a tower determines which of two objects is the top, in one or several
sentences. Objects have their full name, their color alone, or *the other one*.
"""

import re
import tomllib
from bisect import bisect
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import accumulate

import numpy as np

from lemma.scene.objects.entity import Entity, entity_named, kind_of
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.tasks.language.bank import words
from lemma.tasks.language.template import GoalPairs

_PART = re.compile(
    r"<(?P<name>[a-z_]+)(?:/(?P<form>s|ing|ed))?(?::(?P<tag>[a-z]))?(?:@(?P<of>[12]))?>"
    r"|\{(?P<role>[TBXR])(?P<pair>[12])?(?P<bare>\.)?\}"
)
_WEIGHT = re.compile(r"(\d+)\* ")
_FORMS = {"s": 1, "ing": 2, "ed": 3}
_INFLECTED = ("verbs", "sits", "holds", "takes", "reaches")
_PER_FORM = len(_FORMS) + 1
_STYLES = ("full",) * 9 + ("mixed",) * 6 + ("short",) * 3 + ("bare", "bare", "foreign")
"""Styles of names of objects in a sentence, to draw from."""
_NAMES = (
    *("the {n} that is {c}", "the {n} which is {c}", "the {c} colored {n}"),
    *("the {c} coloured {n}", "the {n} in {c}", "the {n} of {c} color"),
    *("the {n} with the color {c}", "the {n} whose color is {c}", "the small {c} {n}"),
    *("the {n} , the {c} one ,", "a {c} {n}", "this {c} {n}", "your {c} {n}"),
    *("that {c} {n}", "our {c} {n}", "the {c} {n} over there", "the nice {c} {n}"),
)
_FOREIGN = ("{n} {c}", "the {n} {c}", "{n} of color {c}", "{c} {n}", "the {n} of {c}")
_COLOR, _BARE = ("{c}",), ("{c} one", "the {c} one", "{c}")
_ONE = ("the {c} one", "the {c} one", "the {c}", "{c}")
_FULL = ("the {c} {n}",)
_OF_STYLE = {"short": ("{c} {n}",), "foreign": _FOREIGN}
_ROBOTS = (
    *("one robot", "the other robot", "one arm", "the second arm", "the first robot"),
    *("the left robot", "the right arm", "one of you", "the other one of you"),
    *("the white robot", "the red robot", "the white arm", "the red arm", "a robot"),
)
_SPACES = re.compile(r"\s+(?=[,.;:?!])|(?<=\s)\s+")
_Part = str | re.Match[str]


@dataclass(frozen=True)
class _Rule:
    """Alternative expansions of a rule."""

    options: tuple[tuple[_Part, ...], ...]
    upto: tuple[float, ...]
    """Cumulative probability of the options."""


class Grammar:
    """A grammar of instructions."""

    def __init__(
        self, rules: Mapping[str, Sequence[str]], without: Collection[str] = ()
    ) -> None:
        """Read the rules.

        Args:
            rules: Texts by name of the rule.
            without: Names of rules to leave out, with all texts that refer to them.
        """
        self.rules = {
            name: _rule([text for text in texts if not _names(text) & set(without)])
            for name, texts in rules.items()
            if name not in without
        }
        lines = [*(text for texts in rules.values() for text in texts), *_NAMES]
        lines += [*_FOREIGN, *_ROBOTS]
        bare = (re.sub(r"\{[^{}]*\}", " ", _PART.sub(" ", line)) for line in lines)
        self.words = tuple(sorted({word for line in bare for word in words(line)}))

    def say(self, goal_pairs: GoalPairs, rng: np.random.Generator) -> str:
        """Return an instruction for a goal.

        Args:
            goal_pairs: One or two (top, bottom) pairs of entities.
            rng: Random generator.
        """
        return _Speaker(self.rules, goal_pairs, rng).sentence()


@cache
def grammar() -> Grammar:
    """Return the grammar of the package."""
    source = files("lemma.policies.text") / "data" / "grammar.toml"
    sections = tomllib.loads(source.read_text(encoding="utf-8"))
    return Grammar({k: v for section in sections.values() for k, v in section.items()})


def speaks_of(goal_pairs: GoalPairs) -> bool:
    """Return whether the grammar covers a goal: one or two cubes on pads or cubes."""
    kinds = {(kind_of(top).name, kind_of(bottom).name) for top, bottom in goal_pairs}
    return len(goal_pairs) <= 2 and kinds <= {("cube", "pad"), ("cube", "cube")}


def _names(text: str) -> set[str]:
    return {found["name"] for found in _PART.finditer(text) if found["name"]}


def _rule(texts: Sequence[str]) -> _Rule:
    options: list[tuple[_Part, ...]] = []
    weights = []
    for text in texts:
        weight = _WEIGHT.match(text)
        end = weight.end() if weight else 0
        weights.append(int(weight[1]) if weight else 1)
        parts: list[_Part] = []
        for found in _PART.finditer(text, end):
            parts += [text[end : found.start()], found]
            end = found.end()
        options.append((*parts, text[end:]))
    total = sum(weights)
    return _Rule(tuple(options), tuple(upto / total for upto in accumulate(weights)))


class _Speaker:
    """State of the generation of one sentence: its choices and mentioned objects."""

    def __init__(
        self, rules: dict[str, _Rule], goal_pairs: GoalPairs, rng: np.random.Generator
    ) -> None:
        self.rules, self.rng = rules, rng
        self.draws: list[float] = []
        self.pairs = [
            (entity_named(top), entity_named(bottom)) for top, bottom in goal_pairs
        ]
        if self.draw() < 0.5:
            self.pairs.reverse()
        self.on_cubes = all(bottom.kind.cargo for _, bottom in self.pairs)
        self.style = self.of(_STYLES)
        self.nouns = {kind: self.make(kind) for kind in ("cube", "pad")}
        self.chosen: dict[tuple[str, ...], str] = {}
        self.named: set[Entity] = set()

    def sentence(self) -> str:
        """Return the sentence, without spaces before punctuation."""
        text = self.make("one" if len(self.pairs) == 1 else "two")
        return _SPACES.sub("", text).strip(" ,;")

    def draw(self) -> float:
        """Return a random number in [0, 1)."""
        if not self.draws:
            self.draws = self.rng.random(64).tolist()
        return self.draws.pop()

    def of(self, options: Sequence[str]) -> str:
        """Return one of several texts; a single text needs no draw."""
        return options[int(self.draw() * len(options)) if len(options) > 1 else 0]

    def make(self, name: str, pair: int = 0, form: int = 0) -> str:
        """Return an expansion of a rule."""
        if name[0] == "w" and name in ("wcube", "wcubes", "wbottom", "wbottoms"):
            kind = "cube" if "cube" in name or self.on_cubes else "pad"
            return self.nouns[kind] + "s" * name.endswith("s")
        special = f"{name}_cubes" if self.on_cubes else f"{name}_pad"
        rule = self.rules.get(special) or self.rules[name]
        option = rule.options[bisect(rule.upto, self.draw())]
        if name in _INFLECTED:
            forms = str(option[0]).split()
            size = len(forms) // _PER_FORM
            return " ".join(forms[form * size : (form + 1) * size])
        return "".join([self.part(part, pair) for part in option])

    def part(self, part: _Part, pair: int) -> str:
        """Return the expansion of a part of a rule."""
        if isinstance(part, str):
            return part
        name, form, tag, of, role, which, bare = part.groups()
        if role == "R":
            return self.of(_ROBOTS)
        if role == "X":
            return self.other()
        if role:
            entity = self.pairs[int(which) - 1 if which else pair][role == "B"]
            return entity.color if bare else self.mention(entity)
        pair = int(of) - 1 if of else pair
        if tag is None:
            return self.make(name, pair, _FORMS.get(form, 0))
        # Both relations of a sentence use the same words.
        key = (name, form, tag)
        if key not in self.chosen:
            self.chosen[key] = self.make(name, pair, _FORMS.get(form, 0))
        return self.chosen[key]

    def mention(self, entity: Entity) -> str:
        """Return a name for an entity, without the noun if its kind is clear."""
        kind, style = entity.kind, self.style
        known = any(other.kind is kind for other in self.named)
        again = entity in self.named
        self.named.add(entity)
        draw = self.draw()
        forms: Sequence[str]
        # Omit the noun more often for two cubes than for a cube and a pad.
        if style == "bare" and (kind.cargo or draw < 0.4):
            forms = _BARE if self.on_cubes and draw >= 0.6 else _COLOR
        elif (style == "mixed" and known and draw < 0.65) or (again and draw < 0.3):
            forms = _ONE
        elif style == "mixed" and kind.cargo and draw > 0.92:
            forms = _COLOR
        else:
            noun = self.nouns[kind.name]
            if style != "full" and draw < 0.15:
                noun = self.make(kind.name)
            forms = _OF_STYLE.get(style, _FULL)
            if forms is _FULL and self.draw() >= 0.8:
                forms = _NAMES
            return self.of(forms).format(c=entity.color, n=noun)
        return self.of(forms).format(c=entity.color)

    def other(self) -> str:
        """Return a name for an object that is not in the goal."""
        meant = {(e.color, e.kind.name) for pair in self.pairs for e in pair}
        for _ in range(20):
            color, kind = self.of(BENCHMARK_COLORS), self.of(("cube", "pad"))
            if (color, kind) not in meant:
                return f"the {color} {self.nouns[kind]}"
        return "anything else"
