"""Entities: a color and a kind, and the names by which everything speaks of them.

An entity is called by its color and its kind (``"red_cube"``), or by the kind alone
where that comes in one color (``"stick"``). Instances, plans, actions and data hold
these names; :func:`entity_named` is the one place that takes them apart.

The numbers of actions and labels count :data:`ENTITIES`, the benchmark's own. These
never change. Entities of users come behind them, and behind ``"shared"`` where
that is a choice too: see :func:`known_entities`.
"""

from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations

from lemma.core.errors import UnknownNameError
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.kind import OBJECT_KINDS, ObjectKind
from lemma.scene.objects.pad import PAD
from lemma.scene.objects.palette import BENCHMARK_COLORS, OBJECT_COLORS, Rgba
from lemma.scene.objects.stick import STICK_KIND


@dataclass(frozen=True, slots=True)
class Entity:
    """An object that may be on a table: at most one in each scene."""

    color: str
    """A name in the palette; empty for a kind of one color."""
    kind: ObjectKind

    def __post_init__(self) -> None:
        """Check the color.

        Raises:
            UnknownNameError: No such color.
        """
        if self.kind.colored:
            OBJECT_COLORS[self.color]
        elif self.color:
            raise UnknownNameError(f"color of a {self.kind.name}", self.color, ("",))

    @property
    def name(self) -> str:
        """``"red_cube"``; ``"stick"`` for a kind of one color."""
        return f"{self.color}_{self.kind.name}" if self.color else self.kind.name

    @property
    def phrase(self) -> str:
        """How instructions speak of it: ``"red cube"``, ``"yellow stick"``."""
        return " ".join(filter(None, (self.color, self.kind.nouns[0])))

    @property
    def rgba(self) -> Rgba:
        """Its paint."""
        return OBJECT_COLORS[self.color] if self.kind.color is None else self.kind.color


STICK = STICK_KIND.name
"""Name of the one L-shaped stick."""
SHARED = "shared"
"""Name of the region that every robot of a team reaches: a place like an entity."""
HAND = "hand"
"""Name of any robot's hand, in goals: a cube that is in one, or one over a cube."""
ENTITIES = (
    *(Entity(color, CUBE).name for color in BENCHMARK_COLORS),
    *(Entity(color, PAD).name for color in BENCHMARK_COLORS),
    STICK,
)
"""The benchmark's entities, in the order of their numbers. Weights and data count on
it, so it does not grow with what is registered."""


def pair_regions(team_size: int) -> tuple[str, ...]:
    """Return the names of all places that two of a team may share: ``"shared_01"``.

    A pair has none: what it shares is :data:`SHARED`.
    """
    pairs = combinations(range(team_size), 2) if team_size > 2 else ()
    return tuple(f"{SHARED}_{first}{second}" for first, second in pairs)


def is_region(name: str) -> bool:
    """Whether a place is no object, but a part of the table that robots share."""
    return name == SHARED or name.startswith(f"{SHARED}_")


def entity_named(name: str) -> Entity:
    """Return the entity of a name.

    Raises:
        UnknownNameError: No registered color and kind make it.
    """
    return Entity(*_color_and_kind(name))


def kind_of(name: str) -> ObjectKind:
    """Return the kind of an entity.

    Raises:
        UnknownNameError: No registered color and kind make it.
    """
    return _color_and_kind(name)[1]


def _color_and_kind(name: str) -> tuple[str, ObjectKind]:
    color, separator, kind = name.rpartition("_")
    if kind in OBJECT_KINDS:
        record = OBJECT_KINDS[kind]
        if color in OBJECT_COLORS if record.colored else not separator:
            return color, record
    raise UnknownNameError("entity", name, known_entities(tuple(OBJECT_KINDS)))


def known_entities(kinds: Collection[str] = ()) -> tuple[str, ...]:
    """Return every entity that may be on a table now: their order is their number.

    :data:`ENTITIES` come first, then what was registered since: by kind, in each by
    color, both in the order of registration.

    Args:
        kinds: Kinds that only some tasks have (:attr:`.Task.kinds`), and that count
            too.
    """
    every = (
        Entity(color, kind).name
        for kind in map(OBJECT_KINDS.__getitem__, OBJECT_KINDS)
        if kind.listed or kind.name in kinds
        for color in (OBJECT_COLORS if kind.colored else ("",))
    )
    return tuple(dict.fromkeys((*ENTITIES, *every)))


def extra_entities(kinds: Collection[str] = ()) -> tuple[str, ...]:
    """Return the entities of :func:`known_entities` that are not the benchmark's.

    Args:
        kinds: See there.
    """
    return known_entities(kinds)[len(ENTITIES) :]
