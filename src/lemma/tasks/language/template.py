"""Templates of instructions, with slots for the roles of a goal, and template banks.

A goal is a conjunction of ``On(top, bottom)``. Rendering a template fills its slots
with the goal's entities; parsing is the exact inverse.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.scene.objects.entity import HAND, Entity, entity_named
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.palette import BENCHMARK_COLORS, OBJECT_COLORS
from lemma.tasks.language.slots import (
    SLOT,
    bare,
    colored_nouns,
    is_of_one_color,
    pattern_of,
)

GoalPairs = tuple[tuple[str, str], ...]
"""A ``(top, bottom)`` pair of entity names for each predicate of a goal; either may be
``"hand"``, see :mod:`lemma.tasks.goal`."""

KindPairs = tuple[tuple[str, str], ...]
"""A ``(top, bottom)`` pair of entity kinds for each predicate of a goal. Templates have
no slot for the gripper, for a kind of a single color, and for an entry that is an
earlier role, such as ``"top1"`` in ``(("cube", "pad"), ("plank", "top1"))``."""

KINDS = ("high_level", "human", "unseen")
"""Kinds of instructions in every instance and every recipe; ``unseen`` ones are held
out of training."""

BLIND = "blind"
"""The kind for evaluation alone, see :mod:`lemma.tasks.language.blind`."""

EVALUATION_KINDS = (*KINDS, BLIND)
"""Kinds of instructions for evaluation, as in the protocol and published tables."""

RELATIONAL = "relational"
"""The kind that names things by their places, :mod:`lemma.tasks.language.relational`.
It is in no table of the protocol."""

ALL_KINDS = (*EVALUATION_KINDS, RELATIONAL)
"""All kinds of instructions that environments and evaluations can give."""

MAX_CHARACTERS = 200
"""Largest length of a rendered sentence."""

_ROLE = re.compile(r"(?:top|bottom)[1-9]")
_SLOT_HELP = (
    "Slots are {top}, {bottom} ('red cube'), {top.color}, {bottom.color} ('red') and "
    "{top.kind}, {bottom.kind} ('cube'); with several conjuncts {top1}, {bottom1}, "
    "{top2}, ..."
)


@dataclass(frozen=True, slots=True)
class Template:
    """A sentence with slots for the roles of a goal.

    Raises:
        InvalidConfigError: The text is not a usable template.
    """

    text: str
    """The sentence, such as ``"Place the {top} on the {bottom.color} circle"``."""
    entity_kinds: KindPairs | None = None
    """Kinds of (top, bottom) per conjunct; None if slots of the text have the kinds."""

    def __post_init__(self) -> None:
        """Check slots, characters and length."""
        self._check_text()
        for number, kinds in enumerate(self.entity_kinds or (), 1):
            if any(_ROLE.fullmatch(k) and int(k[-1]) >= number for k in kinds):
                raise self._error("a role in entity_kinds must be of an earlier pair")
        self._check_roles()
        longest = max(BENCHMARK_COLORS, key=len)
        size = len(SLOT.sub(lambda slot: self._fill(slot, longest, "cube"), self.text))
        if size > MAX_CHARACTERS:
            raise self._error(
                f"it renders to {size} characters; at most {MAX_CHARACTERS} fit. "
                "Shorten it"
            )

    @classmethod
    def from_string(
        cls, text: str, entity_kinds: Sequence[Sequence[str]] | None = None
    ) -> Self:
        """Create a template from plain data.

        Args:
            text: The sentence with its slots.
            entity_kinds: Kinds of top and bottom for each conjunct, such as
                ``[["cube", "pad"]]``. Required if the text has only the color of a
                role, as in ``{top.color} block``.

        Raises:
            InvalidConfigError: The text is not a usable template, or the kinds are not
                pairs.
        """
        if entity_kinds is None:
            return cls(text)
        if any(isinstance(p, str) or len(p) != 2 for p in entity_kinds):
            raise InvalidConfigError(
                f"entity_kinds {entity_kinds!r} is not a list of (top, bottom) pairs. "
                "Write for example [['cube', 'pad']]."
            )
        return cls(text, tuple((top, bottom) for top, bottom in entity_kinds))

    @property
    def roles(self) -> tuple[tuple[str, str], ...]:
        """Names of the (top, bottom) roles for each conjunct of the goal."""
        found = {slot["role"] for slot in SLOT.finditer(self.text)}
        if found <= {"top", "bottom"}:
            return (("top", "bottom"),)
        count = max(int(role[-1]) for role in found if role[-1].isdigit())
        for kinds in (self.entity_kinds or ())[count:]:
            count += all(kind in found or is_of_one_color(kind) for kind in kinds)
        return tuple((f"top{n}", f"bottom{n}") for n in range(1, count + 1))

    def render(self, goal_pairs: GoalPairs) -> str:
        """Return the sentence of a goal.

        Args:
            goal_pairs: Names such as ``(("red_cube", "white_pad"), ...)``, in the order
                of the numbered roles.

        Raises:
            InvalidConfigError: The goal has another number of conjuncts, or other
                kinds, than the template.
        """
        if len(goal_pairs) != len(self.roles):
            raise self._error(
                f"it says {len(self.roles)} On(top, bottom), the goal has "
                f"{len(goal_pairs)}. Use a template of the goal's own task"
            )
        entities: dict[str, Entity] = {}
        for roles, pair in zip(self.roles, goal_pairs, strict=True):
            for role, entity in zip(roles, pair, strict=True):
                kind = self._kind(role)
                if HAND in (entity, kind):
                    fits = entity == kind
                else:
                    found = entities[role] = entity_named(entity)
                    fits = found == entities[self._resolved(role)[0]]
                    fits = fits and kind in (None, found.kind.name)
                if not fits:
                    raise self._error(
                        f"its {role!r} is a {kind}, but the goal has {entity!r} there. "
                        "Use a template of the goal's own task"
                    )

        def fill(slot: re.Match[str]) -> str:
            entity = entities[slot["role"]]
            return self._fill(slot, entity.color, entity.kind.nouns[0])

        return SLOT.sub(fill, self.text)

    def parse(self, sentence: str) -> frozenset[tuple[str, str]] | None:
        """Return the goal of a sentence, or None if the template does not match.

        Letter case and final punctuation are ignored. Entities of kinds with a single
        color are recognized if ``entity_kinds`` has their kind.
        """
        nouns = colored_nouns()
        kinds = tuple((role, self._kind(role)) for pair in self.roles for role in pair)
        pattern = pattern_of(self.text, kinds, tuple(OBJECT_COLORS), tuple(nouns))
        match = pattern.fullmatch(bare(sentence))
        if match is None:
            return None
        said = {name: word.lower() for name, word in match.groupdict().items()}
        goal = frozenset(
            (self._entity(top, said, nouns), self._entity(bottom, said, nouns))
            for top, bottom in self.roles
        )
        tops = {top for top, _ in goal}
        said_tops = {self._said(top) for top, _ in self.roles}
        if len(tops) < len(said_tops) or any(top == bottom for top, bottom in goal):
            return None
        return goal

    def wording(self) -> str:
        """Return the text without case, punctuation and colors.

        Templates with equal wordings are duplicates, even if their slots are written
        differently.
        """
        filled = SLOT.sub(lambda slot: self._fill(slot, "*", "*"), self.text)
        return re.sub(r"[^a-z*]+", " ", filled.lower()).strip()

    def _kind(self, role: str) -> str | None:
        return self._resolved(role)[1]

    def _resolved(self, role: str) -> tuple[str, str | None]:
        """Return the role that a role stands for, mostly itself, and its kind."""
        if self.entity_kinds is None:
            return role, None
        conjunct = int(role[-1]) - 1 if role[-1].isdigit() else 0
        entry = self.entity_kinds[conjunct][role.startswith("bottom")]
        return self._resolved(entry) if _ROLE.fullmatch(entry) else (role, entry)

    def _said(self, role: str) -> str:
        """Return what tells a role in a sentence: a role with a slot, or a kind."""
        role, kind = self._resolved(role)
        return kind if kind is not None and is_of_one_color(kind) else role

    def _fill(self, slot: re.Match[str], color: str, noun: str) -> str:
        kind = self._kind(slot["role"])
        noun = noun if kind is None else OBJECT_KINDS[kind].nouns[0]
        parts = {"color": color, "kind": noun, None: f"{color} {noun}".strip()}
        return parts[slot["part"]]

    def _entity(
        self, role: str, said: dict[str, str], nouns: dict[str, ObjectKind]
    ) -> str:
        role, kind = self._resolved(role)
        if kind == HAND:
            return HAND
        if kind is not None and is_of_one_color(kind):
            return Entity("", OBJECT_KINDS[kind]).name
        record = nouns[said[f"{role}_kind"]] if kind is None else OBJECT_KINDS[kind]
        return Entity(said[f"{role}_color"], record).name

    def _check_text(self) -> None:
        if not self.text.isascii() or not self.text.isprintable():
            raise self._error("it is not plain ASCII on one line. Replace the rest")
        if self.text != " ".join(self.text.split()):
            raise self._error("it has needless spaces. Remove them")
        rest = SLOT.sub("", self.text)
        if "{" in rest or "}" in rest:
            raise self._error(f"it has an unknown slot. {_SLOT_HELP}")

    def _check_roles(self) -> None:
        said: dict[str, set[str | None]] = {}
        for slot in SLOT.finditer(self.text):
            said.setdefault(slot["role"], set()).add(slot["part"])
        roles = [role for pair in self.roles for role in pair]
        expected = {r for r in roles if self._said(r) == r and self._kind(r) != HAND}
        if set(said) != expected:
            raise self._error(
                f"it has slots for {sorted(said)}, but needs {sorted(expected)}. "
                f"{_SLOT_HELP}"
            )
        if self.entity_kinds is not None:
            self._check_kinds(self.entity_kinds)
        for role, parts in said.items():
            if not parts & {None, "color"}:
                raise self._error(f"it lacks the color of {role!r}. {_SLOT_HELP}")
            if self.entity_kinds is None and not parts & {None, "kind"}:
                raise self._error(
                    f"it lacks the kind of {role!r}, a cube or a pad. Write "
                    f"{{{role}}}, or give entity_kinds such as [['cube', 'pad']]"
                )

    def _check_kinds(self, entity_kinds: KindPairs) -> None:
        for kind in (kind for pair in entity_kinds for kind in pair):
            if kind != HAND and not _ROLE.fullmatch(kind):
                OBJECT_KINDS[kind]
        if len(entity_kinds) != len(self.roles):
            raise self._error(
                f"it says {len(self.roles)} On(top, bottom), but entity_kinds has "
                f"{len(entity_kinds)}. Give one pair for each"
            )

    def _error(self, reason: str) -> InvalidConfigError:
        return InvalidConfigError(f"Template {self.text!r}: {reason}.")


@dataclass(frozen=True, slots=True)
class LanguageBank:
    """The templates of one task, except blind ones.

    Raises:
        InvalidConfigError: A kind is empty, a wording occurs twice, or the templates
            have different numbers of roles.
    """

    high_level: tuple[Template, ...]
    """Templates that express only the goal."""
    human: tuple[Template, ...]
    """Templates in natural wording, for training."""
    unseen: tuple[Template, ...]
    """Templates like ``human``, held out of training."""

    def __post_init__(self) -> None:
        """Check that each kind has templates and that all differ."""
        seen: dict[str, str] = {}
        counts = set()
        for kind in KINDS:
            if not self.templates(kind):
                raise InvalidConfigError(
                    f"No {kind!r} templates. Give at least one of each: "
                    f"{', '.join(KINDS)}."
                )
            for template in self.templates(kind):
                counts.add(len(template.roles))
                wording = template.wording()
                if wording in seen:
                    raise InvalidConfigError(
                        f"Templates {seen[wording]!r} and {template.text!r} have the "
                        "same wording. Remove or rewrite one."
                    )
                seen[wording] = template.text
        if len(counts) > 1:
            raise InvalidConfigError(
                "The templates of a task must all have one pair of roles for each "
                f"On(top, bottom) of its goal; these have {sorted(counts)} pairs."
            )

    @classmethod
    def from_strings(
        cls,
        high_level: Sequence[str],
        human: Sequence[str],
        unseen: Sequence[str],
        entity_kinds: Sequence[Sequence[str]] | None = None,
    ) -> Self:
        """Create a bank from strings; see :meth:`Template.from_string`."""
        return cls(
            *(
                tuple(Template.from_string(text, entity_kinds) for text in texts)
                for texts in (high_level, human, unseen)
            )
        )

    def templates(self, kind: str) -> tuple[Template, ...]:
        """Return the templates of one kind of instruction.

        Raises:
            UnknownNameError: ``kind`` is not one of :data:`KINDS`.
        """
        known("kind of instruction", kind, KINDS)
        found: tuple[Template, ...] = getattr(self, kind)
        return found

    def __iter__(self) -> Iterator[Template]:
        """Iterate over the templates of all kinds."""
        for kind in KINDS:
            yield from self.templates(kind)

    def instruct(
        self, kind: str, goal_pairs: GoalPairs, rng: np.random.Generator
    ) -> str:
        """Draw a template of a kind uniformly, and render it for a goal.

        Args:
            kind: One of :data:`KINDS`.
            goal_pairs: The (top, bottom) entities of the goal.
            rng: Random generator; one integer is drawn.

        Raises:
            UnknownNameError: No such kind.
            InvalidConfigError: The goal has another form than the template.
        """
        candidates = self.templates(kind)
        return candidates[int(rng.integers(len(candidates)))].render(goal_pairs)

    def parse(self, sentence: str) -> frozenset[tuple[str, str]] | None:
        """Return the goal of a sentence.

        Returns:
            The (top, bottom) pairs; None if no template matches the sentence, or
            several match with different goals.
        """
        return only_goal(self, sentence)


def only_goal(
    candidates: Iterable[Template], sentence: str
) -> frozenset[tuple[str, str]] | None:
    """Return the goal on which all templates that match a sentence agree, or None."""
    goals = {template.parse(sentence) for template in candidates} - {None}
    return goals.pop() if len(goals) == 1 else None
