"""Reads relational sentences a second way: all their readings, on the map's cells.

It parses a sentence into noun phrases and tries every thing on the table for each. It
knows no margins: positions are rounded to the cells of the top-down map, so a
description without a margin gets a wrong reading or several.
"""

import math
import re
from collections.abc import Iterator

from lemma.core.poses import Pose2
from lemma.scene.raster import RASTER
from lemma.scene.spec import SceneSpec
from lemma.tasks.language.bank import robot_phrases

Pair = tuple[str, str]
Reading = tuple[frozenset[Pair], tuple[str, ...]]
"""The pairs of a goal; its rule as plain data, or nothing."""

_ORDINALS = {
    word: i for i, word in enumerate(["second", "third", "fourth", "fifth", "sixth"])
}
_HALF_WIDTH = 0.10 / RASTER.cell_m


class Table:
    """Robots and objects on a table: nouns, names and cells."""

    def __init__(self, scene: SceneSpec) -> None:
        self.nouns: dict[str, str] = {}
        self.colors: dict[str, str] = {}
        self.names: dict[str, str] = {}
        self.cells: dict[str, tuple[int, int]] = {}
        robots = zip(scene.robots, scene.robot_names, strict=True)
        phrases = robot_phrases(scene.robots)
        for (robot, name), phrase in zip(robots, phrases, strict=True):
            self._add(name, "robot", robot.color, f"the {phrase}", robot.base)
        for placed in scene.objects:
            noun = placed.entity.kind.nouns[0]
            said = (
                f"the {placed.color} {noun}" if placed.entity.color else f"the {noun}"
            )
            self._add(placed.name, noun, placed.entity.color, said, placed.pose)

    def _add(self, name: str, noun: str, color: str, said: str, at: Pose2) -> None:
        self.nouns[name], self.colors[name], self.names[said] = noun, color, name
        self.cells[name] = RASTER.pixel_from_world(at.x, at.y)

    def column(self, name: str) -> int:
        return self.cells[name][1]

    def of(self, noun: str, *but: str) -> list[str]:
        return [n for n, its in self.nouns.items() if its == noun and n not in but]

    def is_between(self, name: str, one: str, two: str) -> bool:
        (a, b), (c, d), (p, q) = (self.cells[n] for n in (one, two, name))
        square = (c - a) ** 2 + (d - b) ** 2
        share = ((p - a) * (c - a) + (q - b) * (d - b)) / square
        foot = (a + share * (c - a), b + share * (d - b))
        return 0.0 < share < 1.0 and math.dist(foot, (p, q)) <= _HALF_WIDTH

    # --- Noun phrases: every thing that one may mean, and the text that follows it ---

    def plain(self, text: str) -> Iterator[tuple[str, str]]:
        for said, name in self.names.items():
            if re.match(rf"{said}\b", text):
                yield name, text[len(said) :]

    def phrase(self, text: str) -> Iterator[tuple[str, str]]:
        yield from self.plain(text)
        for noun in set(self.nouns.values()):
            if found := re.match(rf"the (left|right)most {noun}\b", text):
                yield from self._in_order(noun, found[1], 0, text[found.end() :])
            ordinals = "|".join(_ORDINALS)
            if found := re.match(
                rf"the ({ordinals}) {noun} from the (left|right)\b", text
            ):
                place = _ORDINALS[found[1]] + 1
                yield from self._in_order(noun, found[2], place, text[found.end() :])
            for words in (
                "nearest to",
                "farthest from",
                "left of",
                "right of",
                "between",
            ):
                start = f"the {noun} {words} "
                if text.startswith(start):
                    yield from self._beside(noun, words, text[len(start) :])

    def _in_order(
        self, noun: str, end: str, place: int, rest: str
    ) -> Iterator[tuple[str, str]]:
        columns = sorted(map(self.column, self.of(noun)), reverse=end == "right")
        for name in self.of(noun):
            if self.column(name) == columns[place]:
                yield name, rest

    def _beside(self, noun: str, words: str, text: str) -> Iterator[tuple[str, str]]:
        for anchor, rest in self.plain(text):
            if words == "between":
                for other, after in self.plain(rest.removeprefix(" and ")):
                    for name in self.of(noun, anchor, other):
                        if self.is_between(name, anchor, other):
                            yield name, after
                continue
            others = self.of(noun, anchor)
            yield from (
                (n, rest) for n in others if self._fits(n, words, anchor, others)
            )

    def _fits(self, name: str, words: str, anchor: str, others: list[str]) -> bool:
        if words in ("left of", "right of"):
            offset = self.column(name) - self.column(anchor)
            return offset < 0 if words == "left of" else offset > 0
        most = min if words == "nearest to" else max
        away = {one: math.dist(self.cells[one], self.cells[anchor]) for one in others}
        return away[name] == most(away.values())


def readings(sentence: str, scene: SceneSpec) -> set[Reading]:
    """Return every reading of a sentence on a table."""
    table = Table(scene)
    body, _, rule = sentence.partition("; ")
    rules = set(_rules(table, rule))
    if found := re.match(
        r"Put every (\w+) (except .*)?on the (\w+) of its color$", body
    ):
        goals = _by_color(table, found[1], found[3], found[2] or "")
        return {(goal, said) for goal in goals for said in rules}
    every: set[Reading] = set()
    plain = body.removesuffix(", both at the same time")
    for pairs, ordered in _parts(table, plain.removeprefix("Put "), ()):
        if plain != body:
            every.add((frozenset(pairs), ("together", *pairs[0], *pairs[1])))
        elif ordered:
            every.add((frozenset(pairs), ("after", *pairs[-1], *pairs[-2])))
        else:
            every |= {(frozenset(pairs), said) for said in rules}
    return every


def _rules(table: Table, text: str) -> Iterator[tuple[str, ...]]:
    if not text:
        yield ()
    for name, rest in table.phrase(text):
        if rest == " must not touch anything":
            yield "without", name
    for name, rest in table.phrase(text.removeprefix("nothing may touch ")):
        if not rest:
            yield "but", name


def _by_color(
    table: Table, top: str, bottom: str, text: str
) -> Iterator[frozenset[Pair]]:
    def kept(text: str) -> Iterator[tuple[str, ...]]:
        for name, rest in table.phrase(text):
            if rest == " ":
                yield (name,)
            elif rest.startswith(" and "):
                yield from ((name, *more) for more in kept(rest.removeprefix(" and ")))

    for stay in kept(text.removeprefix("except ")) if text else [()]:
        pairs = set()
        for name in table.of(top, *stay):
            color = table.colors[name]
            (its,) = [n for n in table.of(bottom) if table.colors[n] == color]
            pairs.add((name, its))
        yield frozenset(pairs)


def _parts(
    table: Table, text: str, before: tuple[Pair, ...], *, ordered: bool = False
) -> Iterator[tuple[tuple[Pair, ...], bool]]:
    """Yield the pairs that a text adds to those before it; whether the last waits."""
    for top, rest in table.phrase(text):
        for pairs, after in _placed(table, top, rest, before):
            if not after:
                yield (*before, *pairs), ordered
            for link in (", ", " and "):
                if after.startswith(link + "the "):
                    yield from _parts(table, after[len(link) :], (*before, *pairs))
            if after.startswith(link := " and only after that "):
                following = after[len(link) :]
                yield from _parts(table, following, (*before, *pairs), ordered=True)


def _placed(
    table: Table, top: str, text: str, before: tuple[Pair, ...]
) -> Iterator[tuple[tuple[Pair, ...], str]]:
    if found := re.match(r" on both (\w+)s\b", text):
        posts = [name for name, _ in before if table.nouns[name] == found[1]]
        if len(posts) == 2:
            yield tuple((top, post) for post in posts), text[found.end() :]
    if text.startswith(" on "):
        for bottom, rest in table.phrase(text.removeprefix(" on ")):
            yield ((top, bottom),), rest
