"""Slots of templates, and the patterns that recognize rendered sentences."""

import re
from collections.abc import Sequence
from functools import lru_cache

from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind

SLOT = re.compile(r"\{(?P<role>(?:top|bottom)[1-9]?)(?:\.(?P<part>color|kind))?\}")
"""A slot: a role, alone or with the part of the entity that is said."""

Kinds = tuple[tuple[str, str | None], ...]
"""The kind of each role, or None if the sentence has it."""


def is_of_one_color(kind: str) -> bool:
    """Return whether a kind exists and has a single color."""
    return kind in OBJECT_KINDS and not OBJECT_KINDS[kind].colored


def colored_nouns() -> dict[str, ObjectKind]:
    """Return the kinds with colors that may be in a goal, by noun."""
    kinds = (OBJECT_KINDS[name] for name in OBJECT_KINDS)
    return {kind.nouns[0]: kind for kind in kinds if kind.colored and not kind.tool}


def bare(sentence: str) -> str:
    """Return a sentence without repeated spaces and final punctuation."""
    return " ".join(sentence.split()).rstrip(" .!?")


@lru_cache(maxsize=4096)
def pattern_of(
    template: str, kinds: Kinds, colors: tuple[str, ...], nouns: tuple[str, ...]
) -> re.Pattern[str]:
    """Return a pattern for the rendered sentences of a template.

    Repeated mentions of a role must be equal.

    Args:
        template: Text with slots.
        kinds: Kinds of the roles.
        colors: Names of all colors.
        nouns: Nouns of roles without a kind.
    """
    text, pieces, end, said = bare(template), [], 0, set()
    kind_of = dict(kinds)

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
            kind = kind_of[role]
            noun = () if kind is None else OBJECT_KINDS[kind].nouns[:1]
            pieces.append(group(f"{role}_kind", noun or nouns))
        end = slot.end()
    pieces.append(re.escape(text[end:]))
    return re.compile("".join(pieces), re.IGNORECASE)
