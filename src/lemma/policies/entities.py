"""The entities that a learned policy has numbers for: registered kinds by colors.

A model is made for a set of entities, by default all that are known when its training
begins, and its weights name them. Properties of a thing, such as its
height, is read from the record of its kind.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.scene.objects.entity import (
    ENTITIES,
    SHARED,
    STICK,
    entity_named,
    kind_of,
    known_entities,
)
from lemma.scene.objects.kind import ObjectKind


@dataclass(frozen=True)
class EntitySet:
    """Entities by number: first what is moved, then what is fixed, last the stick."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, names: Iterable[str] = ()) -> "EntitySet":
        """Return a set in the order of its numbers.

        Args:
            names: Names of entities; all that are known now, if empty.

        Raises:
            UnknownNameError: No registered color and kind make one of them.
            InvalidConfigError: They are not different, or there is another tool than
                the stick, or no stick, or nothing to move.
        """
        chosen = tuple(names) or known_entities()
        rank = {name: (k.tool, k.fixed) for name in chosen for k in (kind_of(name),)}
        found = cls(tuple(sorted(chosen, key=rank.__getitem__)))
        tools = [name for name, (tool, _) in rank.items() if tool]
        if len(rank) < len(chosen) or tools != [STICK] or not found.cargo:
            raise InvalidConfigError(
                f"Learned policies cannot count {', '.join(chosen)}. They need "
                f"different entities, among them something to move, and the {STICK} "
                "as the one tool."
            )
        return found

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.names)

    @cached_property
    def kinds(self) -> tuple[ObjectKind, ...]:
        """The kind of each."""
        return tuple(map(kind_of, self.names))

    @cached_property
    def cargo(self) -> int:
        """How many are there to be moved; they come first."""
        return sum(kind.cargo for kind in self.kinds)

    @property
    def stick(self) -> int:
        """Number of the stick: of things to move and fixed things there are so many."""
        return len(self.names) - 1

    @property
    def shared(self) -> int:
        """Number of the place that every robot reaches."""
        return len(self.names)

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Where a sub-task may put something."""
        return (*self.names, SHARED)

    @cached_property
    def colors(self) -> tuple[str, ...]:
        """The colors that may change places: everything colored comes in them."""
        colored = [e for e in map(entity_named, self.names) if e.color]
        kinds = {entity.kind.name for entity in colored}
        return tuple(
            color
            for color in dict.fromkeys(entity.color for entity in colored)
            if all(f"{color}_{kind}" in self.names for kind in kinds)
        )

    @cached_property
    def colored_as(self) -> tuple[tuple[int, ...], ...]:
        """Each entity's number if it had each of the colors; its own if it has none."""
        found = []
        for number, name in enumerate(self.names):
            entity = entity_named(name)
            alike = [f"{color}_{entity.kind.name}" for color in self.colors]
            changes = entity.color in self.colors
            found.append(tuple(self.number(n) if changes else number for n in alike))
        return tuple(found)

    @cached_property
    def color_numbers(self) -> tuple[int, ...]:
        """Which of the colors each entity has; 0 where that makes no difference."""
        found = (entity_named(name).color for name in self.names)
        return tuple(
            self.colors.index(color) if color in self.colors else 0 for color in found
        )

    def number(self, name: str) -> int:
        """Return the number of an entity, or of ``shared``.

        Raises:
            InvalidConfigError: It is none of these.
        """
        if name not in self.places:
            raise InvalidConfigError(
                f"This policy has no number for {name!r}: it was made for "
                f"{', '.join(self.names)}. Train one on data with it, or leave it out."
            )
        return self.places.index(name)


BENCHMARK = EntitySet.of(ENTITIES)
"""The benchmark's own."""


@dataclass(frozen=True, eq=False)
class Traits:
    """Properties of the kinds of E entities; tensors of shape (E,)."""

    height_m: Tensor
    """Height of its top above what it lies on [m]."""
    top_m: Tensor
    """Height of its top above its frame [m]."""
    disc_m: Tensor
    """Radius of a disc that covers it [m]."""
    side_m: Tensor
    """From its middle to its sides [m]."""
    support_m: Tensor
    """How far from its middle the middle of what lies on it may be; -1 if nothing."""
    turn_rad: Tensor
    """A turn by which its grasp is the same; 0 for what is held from any side."""
    grasp_yaw: Tensor
    """Yaw of the gripper in its frame [rad]."""
    faceted: Tensor
    """Whether it is held along its faces."""
    graspable: Tensor
    """Whether a gripper holds it."""
    draggable: Tensor
    """Whether the stick may drag it."""
    drag_m: Tensor
    """From its middle to where the stick touches it; 0 if it never does [m]."""


@lru_cache(maxsize=32)
def traits_of(entities: EntitySet, device: torch.device) -> Traits:
    """Return what is known of the kinds of some entities, on a device."""
    kinds = entities.kinds
    grasps = [kind.grasp for kind in kinds]
    supports = [kind.support_m for kind in kinds]

    def column(values: Iterable[float]) -> Tensor:
        return torch.tensor(list(values), device=device)

    # Cached, so they must not be inference tensors.
    with torch.inference_mode(False):
        return Traits(
            height_m=column(kind.height_m for kind in kinds),
            top_m=column(kind.top_m for kind in kinds),
            disc_m=column(kind.disc_m for kind in kinds),
            side_m=column(kind.side_m for kind in kinds),
            support_m=column(-1.0 if far is None else far for far in supports),
            turn_rad=column(grasp.turn_rad if grasp else 0.0 for grasp in grasps),
            grasp_yaw=column(grasp.at.yaw if grasp else 0.0 for grasp in grasps),
            faceted=column(kind.faceted for kind in kinds),
            graspable=column(grasp is not None for grasp in grasps),
            draggable=column(kind.drag_m is not None for kind in kinds),
            drag_m=column(kind.drag_m or 0.0 for kind in kinds),
        )


def poses_of(
    objects: NDArray[Any], recorded: Sequence[str], entities: EntitySet
) -> NDArray[Any]:
    """Return poses (N, E, 7) in the order of the entities' numbers.

    Args:
        objects: Poses, NaN where an entity is not on the table, (N, recorded, 7).
        recorded: Names of these rows.
        entities: Their numbers.

    Raises:
        DatasetError: Something is on a table that has no number.
    """
    found = np.full((len(objects), len(entities), objects.shape[2]), np.nan)
    for row, name in enumerate(recorded):
        if name in entities.names:
            found[:, entities.number(name)] = objects[:, row]
        elif np.isfinite(objects[:, row, 0]).any():
            raise DatasetError(
                f"There is a {name} on tables of these data, and the model has no "
                "number for it: it was made for "
                f"{', '.join(entities.names)}. Train one "
                "from the start, with --plugin FILE if the file registers it, or leave "
                "out the tasks that have it."
            )
    return found
