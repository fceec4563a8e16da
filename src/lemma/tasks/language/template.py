"""Sentences with slots for the roles of a goal, and banks of them.

A goal is a conjunction of ``On(top, bottom)``. Rendering a template fills its slots
with the goal's entities; parsing is the exact inverse.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.scene.objects.entity import HAND, Entity, entity_named
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.palette import BENCHMARK_COLORS, OBJECT_COLORS

GoalPairs = tuple[tuple[str, str], ...]
"""One ``(top, bottom)`` pair of entity names for each predicate of a goal; one of them
may be the hand, see :mod:`lemma.tasks.goal`."""

KindPairs = tuple[tuple[str, str], ...]
"""The entity kinds of ``(top, bottom)``, for each predicate of a goal. Templates have
no slot for the hand, nor need they have one for a kind of one color, or for a role that
stands for an earlier one: ``(("cube", "pad"), ("plank", "top1"))``."""

KINDS = ("high_level", "human", "unseen")
"""Kinds of instructions that every instance carries and every recipe records;
``unseen`` ones are held out of training."""

BLIND = "blind"
"""The kind that is for evaluation alone, see :mod:`lemma.tasks.language.blind`."""

EVALUATION_KINDS = (*KINDS, BLIND)
"""Kinds of instructions that a policy may be given."""

MAX_CHARACTERS = 200
"""Longest sentence that a template may render to."""

SLOT = re.compile(r"\{(?P<role>(?:top|bottom)[1-9]?)(?:\.(?P<part>color|kind))?\}")
"""A slot: a role, alone or with the part of the entity that is said."""

_ROLE = re.compile(r"(?:top|bottom)[1-9]")
_SLOT_HELP = (
    "Slots are {top}, {bottom} ('red cube'), {top.color}, {bottom.color} ('red') and "
    "{top.kind}, {bottom.kind} ('cube'); with several conjuncts {top1}, {bottom1}, "
    "{top2}, ..."
)


@dataclass(frozen=True, slots=True)
class Template:
    """A sentence with slots for the roles of a goal; validated when made."""

    text: str
    """The sentence: ``"Place the {top} on the {bottom.color} circle"``."""
    entity_kinds: KindPairs | None = None
    """Kinds of (top, bottom) per conjunct; None: as the slots of the text say."""

    def __post_init__(self) -> None:
        """Check slots, characters and length.

        Raises:
            InvalidConfigError: The text is not a usable template.
        """
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
        """Make a template from plain data.

        Args:
            text: The sentence with its slots.
            entity_kinds: ``[["cube", "pad"]]``: kinds of top and bottom, for each
                conjunct. Needed where the text says ``{top.color} block`` and not
                ``{top}`` or ``{top.kind}``.
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
        """The names of the (top, bottom) roles, for each conjunct of the goal."""
        found = {slot["role"] for slot in SLOT.finditer(self.text)}
        if found <= {"top", "bottom"}:
            return (("top", "bottom"),)
        count = max(int(role[-1]) for role in found if role[-1].isdigit())
        for kinds in (self.entity_kinds or ())[count:]:
            count += all(kind in found or _is_of_one_color(kind) for kind in kinds)
        return tuple((f"top{n}", f"bottom{n}") for n in range(1, count + 1))

    def render(self, goal_pairs: GoalPairs) -> str:
        """Return the sentence that asks for a goal.

        Args:
            goal_pairs: ``(("red_cube", "white_pad"), ...)``, in the order of the
                numbered roles.

        Raises:
            InvalidConfigError: The goal has another shape than the template.
        """
        if len(goal_pairs) != len(self.roles):
            raise self._error(
                f"it says {len(self.roles)} On(top, bottom), the goal has "
                f"{len(goal_pairs)}. Use a template of the goal's own task"
            )
        entities: dict[str, Entity] = {}
        for roles, pair in zip(self.roles, goal_pairs, strict=True):
            for role, entity in zip(roles, pair, strict=True):
                if HAND in (entity, self._kind(role)):
                    if entity != self._kind(role):
                        raise self._error(
                            f"its {role!r} is a {self._kind(role)}, but the goal has "
                            f"{entity!r} there. Use a template of the goal's own task"
                        )
                    continue
                found = entities[role] = entity_named(entity)
                same = found == entities[self._resolved(role)[0]]
                if not same or self._kind(role) not in (None, found.kind.name):
                    raise self._error(
                        f"its {role!r} is a {self._kind(role)}, but the goal has "
                        f"{entity!r} there. Use a template of the goal's own task"
                    )

        def fill(slot: re.Match[str]) -> str:
            entity = entities[slot["role"]]
            return self._fill(slot, entity.color, entity.kind.nouns[0])

        return SLOT.sub(fill, self.text)

    def parse(self, sentence: str) -> frozenset[tuple[str, str]] | None:
        """Return the goal of a sentence, or None if the template cannot say it.

        Letter case and the final punctuation are ignored. Things that come in one color
        only are found where ``entity_kinds`` names them.
        """
        nouns = _nouns()
        pattern = _pattern(self, tuple(OBJECT_COLORS), tuple(nouns))
        match = pattern.fullmatch(_bare(sentence))
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

        Two templates with one wording are the same template, however their slots
        are written.
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
        return kind if kind is not None and _is_of_one_color(kind) else role

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
        if kind is not None and _is_of_one_color(kind):
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
                raise self._error(f"nothing says the color of {role!r}. {_SLOT_HELP}")
            if self.entity_kinds is None and not parts & {None, "kind"}:
                raise self._error(
                    f"nothing says what {role!r} is, a cube or a pad. Write "
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
    """The templates of one task, but for blind ones; validated when made."""

    high_level: tuple[Template, ...]
    """Say only what shall become true."""
    human: tuple[Template, ...]
    """In the manner that people write; for training."""
    unseen: tuple[Template, ...]
    """Like ``human``, held out of training."""

    def __post_init__(self) -> None:
        """Check that each kind has templates and that all differ.

        Raises:
            InvalidConfigError: A kind is empty, or a wording occurs twice.
        """
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
                        f"Templates {seen[wording]!r} and {template.text!r} say the "
                        "same in the same words. Remove or rewrite one."
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
        """Make a bank from plain strings; see :meth:`Template.from_string`."""
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
        if kind not in KINDS:
            raise UnknownNameError("kind of instruction", kind, KINDS)
        found: tuple[Template, ...] = getattr(self, kind)
        return found

    def __iter__(self) -> Iterator[Template]:
        """Iterate over the templates of every kind."""
        for kind in KINDS:
            yield from self.templates(kind)

    def instruct(
        self, kind: str, goal_pairs: GoalPairs, rng: np.random.Generator
    ) -> str:
        """Draw a template of a kind, uniformly, and render it for a goal."""
        candidates = self.templates(kind)
        return candidates[int(rng.integers(len(candidates)))].render(goal_pairs)

    def parse(self, sentence: str) -> frozenset[tuple[str, str]] | None:
        """Return the one goal that a sentence asks for.

        Returns:
            The (top, bottom) pairs; None if no template says the sentence.
        """
        return only_goal(self, sentence)


def _is_of_one_color(kind: str) -> bool:
    return kind in OBJECT_KINDS and not OBJECT_KINDS[kind].colored


def _nouns() -> dict[str, ObjectKind]:
    """Return the kinds that a goal may speak of and that have colors, by their noun."""
    kinds = (OBJECT_KINDS[name] for name in OBJECT_KINDS)
    return {kind.nouns[0]: kind for kind in kinds if kind.colored and not kind.tool}


def only_goal(
    candidates: Iterable[Template], sentence: str
) -> frozenset[tuple[str, str]] | None:
    """Return the goal on which all templates that say a sentence agree, or None."""
    goals = {template.parse(sentence) for template in candidates} - {None}
    return goals.pop() if len(goals) == 1 else None


def _bare(sentence: str) -> str:
    return " ".join(sentence.split()).rstrip(" .!?")


@lru_cache(maxsize=4096)
def _pattern(
    template: Template, colors: tuple[str, ...], nouns: tuple[str, ...]
) -> re.Pattern[str]:
    """Compile the inverse of ``render``; a role's second mention repeats its first."""
    text, pieces, end, said = _bare(template.text), [], 0, set()

    def group(name: str, options: Sequence[str]) -> str:
        if name in said:
            return f"(?P={name})"
        said.add(name)
        return f"(?P<{name}>{'|'.join(map(re.escape, options))})"

    for slot in SLOT.finditer(text):
        role, part = slot["role"], slot["part"]
        pieces.append(re.escape(text[end : slot.start()]))
        if part != "kind":
            pieces.append(group(f"{role}_color", colors))
        if part is None:
            pieces.append(" ")
        if part != "color":
            kind = template._kind(role)
            noun = () if kind is None else OBJECT_KINDS[kind].nouns[:1]
            pieces.append(group(f"{role}_kind", noun or nouns))
        end = slot.end()
    pieces.append(re.escape(text[end:]))
    return re.compile("".join(pieces), re.IGNORECASE)
