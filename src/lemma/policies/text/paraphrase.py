"""Paraphrases of the training templates.

A network memorises some eighty templates and does not generalise to others. So their
parts are recombined: another template's name for a cube, two short sentences for a goal
of two towers, clauses without meaning added or left out. Other sentences come from the
grammar in :mod:`lemma.policies.text.grammar`. None is a held-out template.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate, chain
from typing import TypeVar

import numpy as np

from lemma.policies.text.grammar import Grammar, grammar, speaks_of
from lemma.policies.text.words import neighbours, word_vectors
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import HAND, Entity, entity_named
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.language.bank import bank_for, words
from lemma.tasks.language.slots import SLOT
from lemma.tasks.language.template import GoalPairs, Template
from lemma.tasks.names import FAMILIES
from lemma.tasks.suite import SUITE

T = TypeVar("T")

_ALL_NOUNS = {*CUBE.nouns, *PAD.nouns}
_NOUN = "(?:cube|block|box|pad|circle|target)"
_ROLE = r"\{(?P<role>(?:top|bottom)[12]?)(?:\.color)?\}"
_MENTION = re.compile(
    rf"(?P<before>{_NOUN}) that is {_ROLE}"
    rf"|{_ROLE.replace('?P<role>', '?P<role2>')}"
    rf"(?: coloured)?(?: (?P<after>{_NOUN}|one)\b)?"
)
_ON = ("on", "on", "onto", "on top of", "on top of", "over", "top")
_UNDER = ("under", "under", "below", "at the bottom of")
_WHERE = (
    r"(?P<relation>(?P<on>on top of|onto|on|over|top)|under|below|at the bottom of)"
)
_RELATION = re.compile(rf"\b{_WHERE}(?= (?:the )?$)")
_FRONT = re.compile(rf"(?:^|, |\. |\band ){_WHERE}(?= (?:the )?$)", re.IGNORECASE)
_PIECE = re.compile(r"[a-z]+(?:['-][a-z]+)*|\d|[^\sa-z\d]+")
_JOINTS = (" and ", ", and ", ". ", ", ", ", then ", ". then ", ", and then ")
_PAIRS = ({"top", "bottom"}, {"top1", "bottom1"}, {"top2", "bottom2"})
_SHORT = 16
"""Largest number of words of a sentence that is joined with another."""


CHANCES: Mapping[str, float] = {
    # A sentence from the grammar, without a template.
    "ruled": 0.65,
    # A template of the task without recombination.
    "native": 0.3,
    # Inverting a relation: the lower object under the upper.
    "turned": 0.3,
    # Beginning with the place: on the pad goes the cube.
    "fronted": 0.2,
    # Another name for an object, at each mention.
    "renamed": 0.6,
    # Leaving out a clause without a mention.
    "clause_dropped": 0.4,
    # Adding such a clause of another template.
    "clause_added": 0.25,
    # Per word other than colors: replacing it by a similar English word.
    "swapped": 0.15,
    # Per word other than colors: leaving it out.
    "left_out": 0.03,
    # Per word other than colors: replacing it by a random English word.
    "strange": 0.02,
    # Per word other than colors: a typing error.
    "mistyped": 0.01,
    # Leaving out the punctuation.
    "unmarked": 0.2,
}
"""Probabilities of the changes to a sentence."""


@dataclass(frozen=True)
class _Sentence:
    """A template as pieces of text between mentions of roles."""

    pieces: tuple[str, ...]
    roles: tuple[str, ...]
    said: tuple[str, ...]
    """The mentions in the template, with a slot for the color."""


def paraphrase(
    task: str,
    goal_pairs: GoalPairs,
    rng: np.random.Generator,
    chances: Mapping[str, float] = CHANCES,
    rules: Grammar | None = None,
) -> str:
    """Return an instruction for a goal, recombined from training templates.

    Args:
        task: Name of the task; its own templates are preferred.
        goal_pairs: The (top, bottom) pairs of entities.
        rng: Random generator.
        chances: Probabilities of the changes, as :data:`CHANCES`.
        rules: Grammar of the sentences without a template; that of the package if None.
    """
    # A hand has no noun, and the grammar does not cover it: only add noise.
    held = any(HAND in pair for pair in goal_pairs)
    if not held and rng.random() < chances["ruled"] and speaks_of(goal_pairs):
        text = _ruled(goal_pairs, rng, rules or grammar())
        return noisy(text, rng, {**chances, "swapped": 0.4 * chances["swapped"]})
    count = len(goal_pairs)
    if held or rng.random() < chances["native"]:
        text = one_of(_own(task), rng).render(goal_pairs)
    elif count > 2 or (count == 2 and rng.random() < 0.5):
        short = _sentences(1, _SHORT)
        text, *more = [
            _say(one_of(short, rng), (pair,), rng, chances) for pair in goal_pairs
        ]
        for one in more:
            text = text.rstrip(".") + one_of(_JOINTS, rng) + one
    else:
        fitting = _sentences(len(goal_pairs))
        text = _say(one_of(fitting, rng), goal_pairs, rng, chances)
    kept = [
        clause
        for clause in _clauses(text)
        if any(word in OBJECT_COLORS for word in words(clause))
        or rng.random() >= chances["clause_dropped"]
    ]
    if rng.random() < chances["clause_added"]:
        clause = one_of(_fillers(), rng)
        kept.insert(0 if rng.random() < 0.5 else len(kept), clause)
    return noisy(", ".join(kept), rng, chances)


def one_of(options: Sequence[T], rng: np.random.Generator) -> T:
    """Return one of several options, with equal probability."""
    return options[int(rng.integers(len(options)))]


def _ruled(goal_pairs: GoalPairs, rng: np.random.Generator, rules: Grammar) -> str:
    """Return a sentence of the grammar that is no held-out template."""
    while True:
        text = rules.say(goal_pairs, rng)
        wording = ("*" if word in OBJECT_COLORS else word for word in words(text))
        if tuple(wording) not in _held_out():
            return text


@cache
def _held_out() -> frozenset[tuple[str, ...]]:
    return frozenset(
        tuple(re.sub(r"[^a-z*' -]", " ", template.wording()).split())
        for task in (*SUITE, *FAMILIES)
        for template in bank_for(task).unseen
    )


def _say(
    sentence: _Sentence,
    goal_pairs: GoalPairs,
    rng: np.random.Generator,
    chances: Mapping[str, float],
) -> str:
    """Return a sentence with a goal's entities, whose kinds may differ from its own."""
    entities: dict[str, Entity] = {}
    for number, pair in enumerate(goal_pairs, 1):
        # Roles have numbers only in sentences of two pairs.
        suffix = number if sentence.roles[-1][-1].isdigit() else ""
        for role, name in zip(("top", "bottom"), pair, strict=True):
            entities[f"{role}{suffix}"] = entity_named(name)
    sentence = _turned(sentence, rng, chances["turned"])
    if rng.random() < chances["fronted"]:
        sentence = _fronted(sentence)
    # Most sentences use one noun per role.
    nouns = {role: one_of(entity.kind.nouns, rng) for role, entity in entities.items()}
    text, mentioned = sentence.pieces[0], set()
    mentions = zip(sentence.roles, sentence.said, sentence.pieces[1:], strict=True)
    for role, said, piece in mentions:
        color, kind, noun = entities[role].color, entities[role].kind, nouns[role]
        named = set(words(said)) & _ALL_NOUNS
        fits = named <= set(kind.nouns) and (named or role in mentioned)
        if rng.random() < chances["renamed"] or not fits:
            forms = [f"{color} {noun}"] * 6
            forms += [f"{noun} that is {color}", f"{color} coloured {noun}"]
            forms += [f"{color} one"] * (2 if role in mentioned else 0)
            said = one_of(forms, rng)
        text += said.replace("*", color) + piece
        mentioned.add(role)
    return text


def _turned(sentence: _Sentence, rng: np.random.Generator, chance: float) -> _Sentence:
    """Return a sentence with some "x on y" inverted to "y under x", or vice versa."""
    pieces, roles = list(sentence.pieces), list(sentence.roles)
    for i in range(1, len(roles)):
        first, second = roles[i - 1 : i + 1]
        if {first, second} not in _PAIRS:
            continue
        upright = first.startswith("top")
        # "x on y", or "on y goes x".
        for j, pattern, on in ((i, _RELATION, upright), (i - 1, _FRONT, not upright)):
            found = pattern.search(pieces[j])
            if found and on is bool(found["on"]) and rng.random() < chance:
                other = one_of(_UNDER if on else _ON, rng)
                start, end = found.span("relation")
                pieces[j] = pieces[j][:start] + other + pieces[j][end:]
                roles[i - 1 : i + 1] = second, first
                break
    return _Sentence(tuple(pieces), tuple(roles), sentence.said)


def _fronted(sentence: _Sentence) -> _Sentence:
    """Return "on y put x" for a sentence "put x on y", and others unchanged."""
    found = _RELATION.search(sentence.pieces[1])
    if len(sentence.roles) != 2 or found is None:
        return sentence
    before, between, after = sentence.pieces
    start = found.start("relation")
    pieces = (between[start:], f" {before}", f" {between[:start].strip()} {after}")
    return _Sentence(pieces, sentence.roles[::-1], sentence.said[::-1])


def noisy(text: str, rng: np.random.Generator, chances: Mapping[str, float]) -> str:
    """Return a text in lower case with words left out, replaced or mistyped."""
    pieces = _PIECE.findall(text.lower())
    draws = rng.random((len(pieces) + 1, 2)).tolist()
    marked = draws.pop()[0] >= chances["unmarked"]
    english = word_vectors().words
    errors = ("left_out", "swapped", "strange", "mistyped")
    upto = list(accumulate(chances[error] for error in errors))
    out = []
    for piece, (draw, which) in zip(pieces, draws, strict=True):
        if not piece[0].isalpha():
            out.append(piece if marked else "")
        elif draw >= upto[3] or piece in OBJECT_COLORS:
            out.append(piece)
        elif draw >= upto[2]:
            at = int(which * len(piece))
            out.append(piece[:at] + piece[at : at + 2][::-1] + piece[at + 2 :])
        elif draw >= upto[1]:
            out.append(english[int(which * len(english))])
        elif draw >= upto[0]:
            others = neighbours(piece)
            out.append(others[int(which * len(others))] if others else piece)
    return " ".join(filter(None, out))


def _clauses(text: str) -> list[str]:
    return [part.strip() for part in re.split(r"[.,;:?!]", text) if part.strip()]


@cache
def _own(task: str) -> tuple[Template, ...]:
    """Return a task's templates, with its high-level one repeated as three entries."""
    bank = bank_for(task)
    return (*bank.human, *bank.high_level, *bank.high_level, *bank.high_level)


@cache
def _sentences(pairs: int, longest: int = 99) -> tuple[_Sentence, ...]:
    found = {
        template.text: _parsed(template)
        for template in _all()
        if len(template.roles) == pairs and len(words(template.text)) <= longest
    }
    return tuple(found.values())


def _all() -> tuple[Template, ...]:
    banks = [bank_for(task) for task in SUITE]
    return tuple(t for bank in banks for t in (*bank.high_level, *bank.human))


def _parsed(template: Template) -> _Sentence:
    pieces, roles, said, end = [], [], [], 0
    kinds = dict(
        zip(chain(*template.roles), chain(*template.entity_kinds or ()), strict=True)
    )
    for match in _MENTION.finditer(template.text):
        role = match["role"] or match["role2"]
        roles.append(role)
        pieces.append(template.text[end : match.start()])
        bare = re.sub(r"\{[^{}]*\.color\}", "*", match[0])
        said.append(re.sub(r"\{[^{}]*\}", f"* {kinds[role]}", bare))
        end = match.end()
    return _Sentence((*pieces, template.text[end:]), tuple(roles), tuple(said))


@cache
def _fillers() -> tuple[str, ...]:
    texts = [SLOT.sub("*", template.text) for template in _all()]
    clauses = {clause for text in texts for clause in _clauses(text)}
    return tuple(sorted(clause for clause in clauses if "*" not in clause))
