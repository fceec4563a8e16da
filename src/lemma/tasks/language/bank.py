"""Instructions: sentences that express goals, and sub-instructions.

The templates of the built-in tasks are the TOML files in ``templates/``: one
high-level, ten human and ten unseen ones per task, and one line per primitive for
sub-instructions.
"""

import re
import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any

import numpy as np

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.core.registry import Registry
from lemma.scene.objects.entity import (
    ENTITIES,
    HAND,
    SHARED,
    entity_named,
    is_region,
    kind_of,
)
from lemma.scene.spec import RobotPlacement
from lemma.tasks.language.template import (
    GoalPairs,
    LanguageBank,
    Template,
    only_goal,
)
from lemma.tasks.names import FAMILIES
from lemma.tasks.subtask import added_phrase, primitive_names
from lemma.tasks.teams.rule import Rule

_WORD = re.compile(r"[a-z]+(?:['-][a-z]+)*")
_FAMILIES = ("cube_on_pad", "cubes_on_pads", "cube_on_cube", "cubes_on_cubes")
_LADDER = ("hand_over_cube", "cube_in_hand", "cube_on_pad_alone")
_UNSEEN_BY_MODELS = (*_LADDER, *FAMILIES)
"""Tasks of the ladder and of teams on which no published model has been trained."""
_PAPER_LINES = (
    *("move", "move_to_shared", "prehook", "hook", "prepoke", "poke", "stop"),
)
_BESIDE_M = 0.1
"""Smallest distance along x between robots that are counted from the left."""
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")
"""Words for places in a row."""


_added: dict[str, LanguageBank] = {}


def add_bank(task: str, bank: LanguageBank) -> None:
    """Store the templates of a registered task."""
    _added[task] = bank


def bank_for(task: str) -> LanguageBank:
    """Return the templates of a built-in or registered task.

    Raises:
        UnknownNameError: No such task.
    """
    if task in _added:
        return _added[task]
    banks = _banks((*_FAMILIES, *_UNSEEN_BY_MODELS))
    if task not in banks:
        raise UnknownNameError("task", task, dict.fromkeys([*banks, *_added]))
    return banks[task]


def templates(task: str, kind: str) -> tuple[Template, ...]:
    """Return the templates of a task for one kind of instruction.

    Raises:
        UnknownNameError: No such task or kind.
    """
    return bank_for(task).templates(kind)


def instruct(
    task: str, kind: str, goal_pairs: GoalPairs, rng: np.random.Generator
) -> str:
    """Draw a random template of a task and render it.

    Args:
        task: Name of the task.
        kind: One of :data:`KINDS`.
        goal_pairs: The (top, bottom) entities of the goal.
        rng: Random generator; one integer is drawn.

    Raises:
        UnknownNameError: No such task or kind.
        InvalidConfigError: The goal has another form than the templates.
    """
    return bank_for(task).instruct(kind, goal_pairs, rng)


def parse(sentence: str) -> frozenset[tuple[str, str]] | None:
    """Return the goal of a sentence of a built-in task.

    Returns:
        The (top, bottom) pairs; None if no template matches the sentence, or several
        match with different goals.
    """
    banks = _banks((*_FAMILIES, *_UNSEEN_BY_MODELS))
    return only_goal([t for name in banks for t in banks[name]], sentence)


def phrase(entity: str) -> str:
    """Return the phrase for an entity or region in sub-instructions.

    Examples are ``"red cube"``, ``"shared space"``, and ``"space of robots 0 and 1"``
    for the region of a pair in a larger team.

    Raises:
        UnknownNameError: No such entity or region.
    """
    if not is_region(entity):
        return entity_named(entity).phrase
    pair = entity.removeprefix(SHARED).removeprefix("_")
    return f"space of robots {' and '.join(pair)}" if pair else "shared space"


def say_pair(top: str, bottom: str) -> str:
    """Return a predicate as text, such as ``"the red cube on the white pad"``."""
    if top == HAND:
        return f"a hand over the {phrase(bottom)}"
    if bottom == HAND:
        return f"the {phrase(top)} in a hand, lifted"
    return f"the {phrase(top)} on the {phrase(bottom)}"


def rule_templates(rule: str, kind: str) -> tuple[str, ...]:
    """Return the templates of a kind of rule, for a kind of instruction.

    Slots are those of :meth:`.Rule.words`, and ``{goal}`` for the sentence of the goal;
    a template without ``{goal}`` expresses the goal itself.
    """
    return tuple(_read("rules")[rule][kind])


def say_rule(
    rule: Rule,
    kind: str,
    goal: str,
    robots: Sequence[str],
    rng: np.random.Generator,
) -> str:
    """Draw a random sentence that expresses a goal and its rule.

    Args:
        rule: The rule.
        kind: One of :data:`KINDS`.
        goal: The sentence of the goal without the rule.
        robots: Phrases of the team.
        rng: Random generator; one integer is drawn.
    """
    candidates = rule_templates(rule.kind, kind)
    chosen = candidates[int(rng.integers(len(candidates)))]
    words = rule.words(robots)
    return chosen.format(goal=goal.rstrip(".") + ".", **words)


def robot_phrases(robots: Sequence[RobotPlacement]) -> tuple[str, ...]:
    """Return a distinct phrase for each robot of a team, by color and position.

    Args:
        robots: The team.

    Returns:
        Phrases such as ``"red robot"``. Two robots of one color are ``"left white
        robot"`` and ``"right white robot"`` as on the top-down map (left is at -x), or
        ``"lower"`` and ``"upper"`` if their distance along y is larger. Three or more
        are counted from the left.

    Raises:
        InvalidConfigError: Of three or more robots of one color, two are equally far
            left, or there are too many to count.
    """
    names = [f"{robot.color} robot" for robot in robots]
    for color in dict.fromkeys(robot.color for robot in robots):
        group = [i for i, robot in enumerate(robots) if robot.color == color]
        if len(group) > 1:
            words = _position_words([robots[i].base for i in group], color)
            for i, which in words.items():
                names[group[i]] = f"{which} {names[group[i]]}"
    return tuple(names)


@cache
def robot_phrases_in_order(colors: tuple[str, ...]) -> tuple[str, ...]:
    """Return :func:`robot_phrases` of a team with known order and unknown positions.

    Args:
        colors: Colors of the robots, from left to right.
    """
    return robot_phrases(
        [RobotPlacement("ur5", c, Pose2(float(x), 0.0)) for x, c in enumerate(colors)]
    )


def _position_words(bases: Sequence[Pose2], color: str) -> dict[int, str]:
    """Return the words that distinguish robots of one color, by index."""
    order = sorted(range(len(bases)), key=lambda i: bases[i].x)
    words: Sequence[str] = ORDINALS
    if len(bases) == 2:
        first, second = (bases[i] for i in order)
        words = ("left", "right")
        if second.x - first.x < abs(second.y - first.y):
            order.sort(key=lambda i: bases[i].y)
            words = ("lower", "upper")
    steps = [bases[b].x - bases[a].x for a, b in pairwise(order)]
    if len(bases) > len(ORDINALS) or (len(bases) > 2 and min(steps) < _BESIDE_M):
        raise InvalidConfigError(
            f"{len(bases)} robots are {color}, and no words tell them apart: up to "
            f"{len(ORDINALS)} are counted from the left, if each stands at least "
            f"{_BESIDE_M:g} m further right than the last. Use more colors."
        )
    return dict(zip(order, words, strict=False))


def sub_instruction(
    robot: str, primitive: str, pick: str | None = None, place: str | None = None
) -> str:
    """Return a sub-task as text, such as ``"red robot: hook the blue cube with ..."``.

    Args:
        robot: The robot's phrase, from :func:`robot_phrases`.
        primitive: Name of a :class:`~lemma.tasks.subtask.Primitive`, also an added one.
        pick: Entity to pick; for hook and poke the stick or the cube.
        place: Entity or region to place it on. For hook and poke, exactly one of pick
            and place is a cube.

    Raises:
        UnknownNameError: No such primitive or entity.
        InvalidConfigError: An entity that the primitive needs is missing.
    """
    lines = _sub_instructions()
    known("primitive", primitive, primitive_names())
    if primitive == "stop":
        return lines["stop"]
    added = added_phrase(primitive)
    if primitive in ("move", "carry", "give") or added is not None:
        if pick is None or place is None:
            raise InvalidConfigError(
                f"{primitive!r} needs pick and place, got pick={pick!r}, "
                f"place={place!r}. Name both, such as 'red_cube' and 'shared'."
            )
        to_region = primitive == "move" and is_region(place)
        line = added or lines["move_to_shared" if to_region else primitive]
        return line.format(robot=robot, pick=phrase(pick), place=phrase(place))
    if primitive in ("reach", "lift"):
        if pick is None:
            raise InvalidConfigError(f"{primitive!r} needs pick, such as 'red_cube'.")
        return lines[primitive].format(robot=robot, pick=phrase(pick))
    cubes = {e for e in (pick, place) if e and not is_region(e) and kind_of(e).cargo}
    if len(cubes) != 1:
        raise InvalidConfigError(
            f"{primitive!r} acts on one cube, got pick={pick!r}, place={place!r}. "
            "Name the stick and the cube, such as 'stick' and 'red_cube'."
        )
    return lines[primitive].format(robot=robot, cube=phrase(cubes.pop()))


def words(sentence: str) -> tuple[str, ...]:
    """Return the words of a sentence in lower case, without punctuation."""
    return tuple(_WORD.findall(sentence.lower()))


def vocabulary() -> tuple[str, ...]:
    """Return all words in training data, sorted.

    These are the words of high-level and human instructions and of sub-instructions of
    the paper's tasks, without words that occur only in unseen templates.
    """
    said = (_sub_instructions()[name] for name in _PAPER_LINES)
    lines = [*said, *map(phrase, ENTITIES), phrase(SHARED)]
    lines += [*ORDINALS, "left right robot"]
    banks = _banks(_FAMILIES)
    for bank in (banks[name] for name in banks):
        lines += [t.text for t in (*bank.high_level, *bank.human)]
    bare = (re.sub(r"\{[^{}]*\}", " ", line) for line in lines)
    return tuple(sorted({word for line in bare for word in words(line)}))


@cache
def _read(name: str) -> dict[str, Any]:
    source = files("lemma.tasks.language") / "templates" / f"{name}.toml"
    return tomllib.loads(source.read_text(encoding="utf-8"))


@cache
def _sub_instructions() -> dict[str, str]:
    return _read("sub_instructions")


@cache
def _banks(families: tuple[str, ...]) -> Registry[LanguageBank]:
    banks: Registry[LanguageBank] = Registry("task", LanguageBank)
    for family in families:
        data = _read(family)
        for task, table in data.items():
            if isinstance(table, dict):
                bank = LanguageBank.from_strings(
                    data["high_level"], **table, entity_kinds=data["entity_kinds"]
                )
                banks.add(task, bank)
    return banks
