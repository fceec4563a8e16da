"""Entities: objects that are identified by color and kind, and their names.

The name of an entity is its color and its kind (``"red_cube"``), or the kind alone if
the kind has one color (``"stick"``). Instances, plans, actions and data refer to
entities by name; only :func:`entity_named` parses names.

Actions and labels number the benchmark's entities, :data:`ENTITIES`, first; these
numbers never change. Entities of users follow, after ``"shared"`` where that is a
choice too: see :func:`known_entities`.
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
    """An object that may be in a scene, at most once.

    Raises:
        UnknownNameError: The kind does not come in this color.
    """

    color: str
    """A name in the palette; empty for a kind with a color of its own."""
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
        """Name of the entity, such as ``"red_cube"`` or ``"stick"``."""
        return f"{self.color}_{self.kind.name}" if self.color else self.kind.name

    @property
    def phrase(self) -> str:
        """The phrase in instructions, such as ``"red cube"``."""
        return " ".join(filter(None, (self.color, self.kind.nouns[0])))

    @property
    def rgba(self) -> Rgba:
        """Color and opacity, each in [0, 1]."""
        return OBJECT_COLORS[self.color] if self.kind.color is None else self.kind.color


STICK = STICK_KIND.name
"""Name of the L-shaped stick."""
SHARED = "shared"
"""Name of the region that every robot of a team reaches; sub-tasks use it like an
entity."""
HAND = "hand"
"""Name of any robot's gripper in goals, which holds a cube or is over one."""
ENTITIES = (
    *(Entity(color, CUBE).name for color in BENCHMARK_COLORS),
    *(Entity(color, PAD).name for color in BENCHMARK_COLORS),
    STICK,
)
"""The benchmark's entities, in the order of their numbers. Weights and data depend on
it, so registered entities are not added."""


def pair_regions(team_size: int) -> tuple[str, ...]:
    """Return the names of the regions of all pairs in a team, such as ``"shared_01"``.

    The result is empty for a team of two, whose region is :data:`SHARED`.
    """
    pairs = combinations(range(team_size), 2) if team_size > 2 else ()
    return tuple(f"{SHARED}_{first}{second}" for first, second in pairs)


def is_region(name: str) -> bool:
    """Return whether a place is a region of the table, not an object."""
    return name == SHARED or name.startswith(f"{SHARED}_")


def is_carried(name: str) -> bool:
    """Return whether a name is of an object that two robots carry by its handles."""
    return not is_region(name) and kind_of(name).carried is not None


def entity_named(name: str) -> Entity:
    """Return the entity of a name.

    Raises:
        UnknownNameError: The name is not that of a registered color and kind.
    """
    return Entity(*_color_and_kind(name))


def kind_of(name: str) -> ObjectKind:
    """Return the kind of an entity.

    Raises:
        UnknownNameError: The name is not that of a registered color and kind.
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
    """Return all entities that exist now, in the order of their numbers.

    :data:`ENTITIES` come first, then registered ones by kind, and for each kind by
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
