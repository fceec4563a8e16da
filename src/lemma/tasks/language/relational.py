"""Relational instructions: they name objects by their places at the beginning.

"The cube nearest to the red robot", "the second pad from the left", "every cube except
the one between ...". Left and right are those of the top-down map: left is at -x. Each
description fits one object of the scene alone, with a margin, all other objects and
distractors considered. Where none does, the plain name is said.

Sentences are computed from the instance's scene and goal, with a random stream of their
own, and are no part of its data. So they affect no other sentence and no digest.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_name
from lemma.core.seeding import stream
from lemma.scene.objects.entity import HAND, entity_named
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import BENCHMARK_VERSION, Instance
from lemma.tasks.language.bank import ORDINALS, robot_phrases
from lemma.tasks.language.template import KINDS, MAX_CHARACTERS, RELATIONAL
from lemma.tasks.names import FAMILIES, SUITE
from lemma.tasks.teams.rule import After, But, Together, Without

NEARER_M = 0.04
"""By how much an object is nearer, or farther, than the next one [m]."""
BESIDE_M = 0.03
"""By how much an object is left or right of another one [m]."""
BETWEEN_M = 0.10
"""Largest distance from the line between two things at which an object is between them
[m]."""
ROBOT = "robot"
"""The noun of robots."""
_OF_PLACES = re.compile(
    r"nearest to|farthest from|leftmost|rightmost|from the (?:left|right)\b"
    r"|\b(?:left|right) of\b|\bbetween the [a-z ]+ and the\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Thing:
    """A robot or an object that a description may be about."""

    noun: str
    """Such as ``"cube"``; descriptions tell things of one noun apart."""
    phrase: str
    """Its plain name, such as ``"red cube"``."""
    at: Pose2
    """World frame; of a robot, its base."""


def has_relational(task: str) -> bool:
    """Return whether instances of a task have relational instructions."""
    return task in SUITE or task in FAMILIES


def check_relational(task: str) -> None:
    """Check that instances of a task have relational instructions.

    Raises:
        InvalidConfigError: They have none.
    """
    if not has_relational(task):
        raise InvalidConfigError(
            f"Instances of task {task!r} have no {RELATIONAL!r} instruction; those of "
            f"{', '.join((*SUITE, *FAMILIES))} have. Choose {', '.join(KINDS)}."
        )


def speaks_of_places(sentence: str) -> bool:
    """Return whether a sentence names things by their places."""
    return _OF_PLACES.search(sentence) is not None


def relational(instance: Instance) -> str:
    """Return the relational instruction of an instance.

    Raises:
        InvalidConfigError: No such sentence says its goal; see :func:`say`.
    """
    key = (BENCHMARK_VERSION, instance.task, instance.split, instance.index)
    return _drawn(key, instance.scene, instance.goal)


@lru_cache(maxsize=4096)
def _drawn(key: tuple[str, str, str, int], scene: SceneSpec, goal: Goal) -> str:
    return say(scene, goal, stream(*key, "language", RELATIONAL))


def things_in(scene: SceneSpec) -> dict[str, Thing]:
    """Return all robots and objects of a scene by name."""
    return things_at(scene.robots, {one.name: one.pose for one in scene.objects})


def things_at(
    robots: Sequence[RobotPlacement], objects: Mapping[str, Pose2]
) -> dict[str, Thing]:
    """Return robots, and objects at their poses, by name."""
    named = enumerate(zip(robot_phrases(robots), robots, strict=True))
    found = {robot_name(i): Thing(ROBOT, text, one.base) for i, (text, one) in named}
    for name, pose in objects.items():
        entity = entity_named(name)
        found[name] = Thing(entity.kind.nouns[0], entity.phrase, pose)
    return found


def describe(things: Mapping[str, Thing], name: str) -> dict[str, list[str]]:
    """Return the descriptions that fit one thing alone, by relation.

    Args:
        things: All robots and objects of the scene, from :func:`things_in`.
        name: The thing. One that is not there, or whose plain name is its noun, such
            as a tray, has no descriptions.

    Returns:
        Phrases such as ``"cube nearest to the red robot"`` for the relations
        ``"nearest"``, ``"order"``, ``"side"`` and ``"between"``; a relation without
        a description is left out.
    """
    me = things.get(name)
    if me is None or me.phrase == me.noun:
        return {}
    ways: dict[str, Callable[[Thing, list[Thing], list[Thing]], Iterator[str]]] = {
        "nearest": _by_distance,
        "order": _by_order,
        "side": _by_side,
        "between": _by_two,
    }
    same = [one for one in things.values() if one.noun == me.noun and one is not me]
    anchors = [one for one in things.values() if one is not me]
    every = {relation: list(way(me, same, anchors)) for relation, way in ways.items()}
    return {relation: found for relation, found in every.items() if found}


def _by_distance(me: Thing, same: list[Thing], anchors: list[Thing]) -> Iterator[str]:
    for anchor in anchors:
        others = [one.at.distance(anchor.at) for one in same if one is not anchor]
        mine = me.at.distance(anchor.at)
        if others and mine <= min(others) - NEARER_M:
            yield f"{me.noun} nearest to the {anchor.phrase}"
        if others and mine >= max(others) + NEARER_M:
            yield f"{me.noun} farthest from the {anchor.phrase}"


def _by_order(me: Thing, same: list[Thing], anchors: list[Thing]) -> Iterator[str]:
    del anchors
    if not same or any(abs(one.at.x - me.at.x) < BESIDE_M for one in same):
        return
    before = [one.at.x < me.at.x for one in same].count(True)
    for end, place in (("left", before), ("right", len(same) - before)):
        if place == 0:
            yield f"{end}most {me.noun}"
        elif place < len(ORDINALS) and place < len(same):
            yield f"{ORDINALS[place]} {me.noun} from the {end}"


def _by_side(me: Thing, same: list[Thing], anchors: list[Thing]) -> Iterator[str]:
    for anchor in anchors:
        offset = me.at.x - anchor.at.x
        others = [one.at.x - anchor.at.x for one in same if one is not anchor]
        for side, sign in (("left", -1.0), ("right", 1.0)):
            if sign * offset >= BESIDE_M and all(
                sign * other <= -BESIDE_M for other in others
            ):
                yield f"{me.noun} {side} of the {anchor.phrase}"


def _by_two(me: Thing, same: list[Thing], anchors: list[Thing]) -> Iterator[str]:
    for one, two in combinations(anchors, 2):
        others = [other for other in same if other not in (one, two)]
        if _between(me, one, two, BESIDE_M) and not any(
            _between(other, one, two, -BESIDE_M) for other in others
        ):
            yield f"{me.noun} between the {one.phrase} and the {two.phrase}"


def _between(me: Thing, one: Thing, two: Thing, margin_m: float) -> bool:
    """Return whether a thing is between two others.

    Args:
        me: The thing.
        one: One end of the line.
        two: The other end.
        margin_m: By how much it must be inside; if negative, it may be outside by this.
    """
    length = one.at.distance(two.at)
    if length <= 0.0:
        return False
    along_x = (two.at.x - one.at.x) / length
    along_y = (two.at.y - one.at.y) / length
    x, y = me.at.x - one.at.x, me.at.y - one.at.y
    along, across = x * along_x + y * along_y, x * along_y - y * along_x
    inside = margin_m < along < length - margin_m
    return inside and abs(across) <= BETWEEN_M - margin_m


def say(scene: SceneSpec, goal: Goal, rng: np.random.Generator) -> str:
    """Draw a sentence about a scene; see :func:`say_of`."""
    return say_of(things_in(scene), goal, rng)


def say_of(things: Mapping[str, Thing], goal: Goal, rng: np.random.Generator) -> str:
    """Draw a sentence that says a goal and its rule by relations.

    Args:
        things: All robots and objects at the beginning of the episode, from
            :func:`things_in`.
        goal: The goal; objects that are not there are said by their names.
        rng: Random generator.

    Returns:
        The sentence. If it had more than :data:`.MAX_CHARACTERS`, some objects, drawn
        at random, are said by their names instead.

    Raises:
        InvalidConfigError: A hand is part of the goal, its rule is about other pairs
            than those of the goal, or the sentence has too many characters even without
            relations.
    """
    if any(HAND in pair for pair in goal.pairs):
        raise InvalidConfigError(
            f"A goal with a hand has no {RELATIONAL!r} instruction. Choose another."
        )
    rule = goal.rule
    kept = _kept_by_color(things, goal)
    # A rule about an object that stays belongs to "every ... except".
    if kept is not None and not isinstance(rule, But) and rng.integers(2):
        kept = None
    named = [*goal.entities] if kept is None else [*kept]
    if isinstance(rule, Without | But):
        named += [name for name in rule.names if name not in named]
    words = {name: thing.phrase for name, thing in things.items()}
    words |= {name: entity_named(name).phrase for name in goal.entities}
    plain = dict(words)
    described = [name for name in named if _draw(things, name, words, rng)]
    order = [described[int(i)] for i in rng.permutation(len(described))]
    while len(text := _sentence(goal, kept, things, words)) > MAX_CHARACTERS:
        if not order:
            raise InvalidConfigError(
                f"{text!r} has {len(text)} characters; at most {MAX_CHARACTERS} fit. "
                "Use a goal of fewer parts."
            )
        name = order.pop()
        words[name] = plain[name]
    return text


def _draw(
    things: Mapping[str, Thing],
    name: str,
    words: dict[str, str],
    rng: np.random.Generator,
) -> bool:
    """Replace the words for a thing by a description; return whether there is one."""
    found = list(describe(things, name).values())
    if not found:
        return False
    # The relation first, since there are many more of two anchors than of one.
    listed = found[int(rng.integers(len(found)))]
    words[name] = listed[int(rng.integers(len(listed)))]
    return True


def _kept_by_color(things: Mapping[str, Thing], goal: Goal) -> tuple[str, ...] | None:
    """Return what stays where everything else of a kind goes to its color.

    Returns:
        At most two objects; None if the goal is another one.
    """
    tops, bottoms = zip(*goal.pairs, strict=True)
    pairs = [(entity_named(a), entity_named(b)) for a, b in goal.pairs]
    alike = len({(top.kind.name, bottom.kind.name) for top, bottom in pairs}) == 1
    by_color = all(top.color == bottom.color != "" for top, bottom in pairs)
    there = all(name in things for name in (*tops, *bottoms))
    if not (alike and by_color and there) or len(pairs) < 2:
        return None
    if isinstance(goal.rule, After | Together):
        return None
    noun = things[tops[0]].noun
    stay = [n for n, one in things.items() if one.noun == noun and n not in tops]
    return tuple(stay) if len(stay) <= 2 else None


def _sentence(
    goal: Goal,
    kept: tuple[str, ...] | None,
    things: Mapping[str, Thing],
    words: Mapping[str, str],
) -> str:
    rule, link = goal.rule, " and "
    if kept is not None:
        top, bottom = (things[name].noun for name in goal.pairs[0])
        stay = " and ".join(f"the {words[name]}" for name in kept)
        stay = f" except {stay}" if stay else ""
        parts = [f"every {top}{stay} on the {bottom} of its color"]
    elif rule is not None and rule.pairs and set(rule.pairs) != set(goal.pairs):
        raise InvalidConfigError(
            f"{rule} is not about all of the goal, so no {RELATIONAL!r} "
            "instruction says it. Choose another kind."
        )
    elif isinstance(rule, After):
        later, first = rule.pairs
        parts, link = _parts((first, later), things, words), " and only after that "
    else:
        parts = _parts(goal.pairs, things, words)
    text = link.join(filter(None, (", ".join(parts[:-1]), parts[-1])))
    if isinstance(rule, Without):
        text += f"; the {words[rule.excluded]} must not touch anything"
    elif isinstance(rule, But):
        text += f"; nothing may touch the {words[rule.thing]}"
    elif isinstance(rule, Together):
        text += ", both at the same time"
    return f"Put {text}"


def _parts(
    pairs: Sequence[tuple[str, str]],
    things: Mapping[str, Thing],
    words: Mapping[str, str],
) -> list[str]:
    """Return the words of pairs; what lies on both tops of the others comes last."""
    found, last, below = list[str](), list[str](), dict[str, list[str]]()
    for top, bottom in pairs:
        below.setdefault(top, []).append(bottom)
    for top, bottoms in below.items():
        posts = [other for other in below if other != top]
        nouns = {things[name].noun for name in posts if name in things}
        if len(bottoms) == 2 and set(bottoms) == set(posts) and len(nouns) == 1:
            last.append(f"the {words[top]} on both {nouns.pop()}s")
        else:
            found += [f"the {words[top]} on the {words[on]}" for on in bottoms]
    return found + last
