"""The entities of a learned policy: registered kinds by colors.

A model has a fixed set of entities, by default all that are registered when its
training begins, and its weights list them. Properties of an entity, such as its height,
come from the record of its kind.
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
from lemma.policies.layers import taken_as_constant
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
    """Entities by number: first movable ones, then fixed ones, last the stick."""

    names: tuple[str, ...]
    regions: tuple[str, ...] = (SHARED,)
    """Regions where a sub-task may place; their numbers follow those of entities."""

    @classmethod
    def of(cls, names: Iterable[str] = ()) -> "EntitySet":
        """Return a set in the order of its numbers.

        Args:
            names: Names of entities; all registered ones if empty.

        Raises:
            UnknownNameError: A name is no registered color and kind.
            InvalidConfigError: Names repeat, the stick or a movable entity is missing,
                or there is a tool besides the stick.
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
        """Return the number of entities."""
        return len(self.names)

    @cached_property
    def kinds(self) -> tuple[ObjectKind, ...]:
        """The kind of each entity."""
        return tuple(map(kind_of, self.names))

    @cached_property
    def cargo(self) -> int:
        """Number of movable entities; they come first."""
        return sum(kind.cargo for kind in self.kinds)

    @property
    def stick(self) -> int:
        """Number of the stick, the last entity."""
        return len(self.names) - 1

    @property
    def shared(self) -> int:
        """Number of the shared region, which every robot reaches."""
        return len(self.names)

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Names of the entities and of the region where a sub-task may place."""
        return (*self.names, *self.regions)

    @cached_property
    def colors(self) -> tuple[str, ...]:
        """The exchangeable colors: each colored kind has all of them."""
        colored = [e for e in map(entity_named, self.names) if e.color]
        kinds = {entity.kind.name for entity in colored}
        return tuple(
            color
            for color in dict.fromkeys(entity.color for entity in colored)
            if all(f"{color}_{kind}" in self.names for kind in kinds)
        )

    @cached_property
    def colored_as(self) -> tuple[tuple[int, ...], ...]:
        """By entity and color, the number of that entity in that color.

        For an entity without a color it is the entity's own number.
        """
        found = []
        for number, name in enumerate(self.names):
            entity = entity_named(name)
            alike = [f"{color}_{entity.kind.name}" for color in self.colors]
            changes = entity.color in self.colors
            found.append(tuple(self.number(n) if changes else number for n in alike))
        return tuple(found)

    @cached_property
    def color_numbers(self) -> tuple[int, ...]:
        """Index into :attr:`colors` of each entity's color; 0 for one without color."""
        found = (entity_named(name).color for name in self.names)
        return tuple(
            self.colors.index(color) if color in self.colors else 0 for color in found
        )

    def number(self, name: str) -> int:
        """Return the number of an entity, or of ``shared``.

        Raises:
            InvalidConfigError: The name is neither.
        """
        if name not in self.places:
            raise InvalidConfigError(
                f"This policy has no number for {name!r}: it was made for "
                f"{', '.join(self.names)}. Train one on data with it, or leave it out."
            )
        return self.places.index(name)


BENCHMARK = EntitySet.of(ENTITIES)
"""The entities of the benchmark."""


@dataclass(frozen=True, eq=False)
class Traits:
    """Properties of the kinds of E entities; tensors of shape (E,)."""

    height_m: Tensor
    """Height of its top above its support [m]."""
    top_m: Tensor
    """Height of its top above its frame [m]."""
    disc_m: Tensor
    """Radius of a disc that covers it [m]."""
    side_m: Tensor
    """Distance of its center from its sides [m]."""
    support_m: Tensor
    """Largest distance of its center from the center of an object on it [m]; -1 if it
    supports nothing."""
    turn_rad: Tensor
    """Rotational symmetry of its grasp [rad]; 0 for a grasp from any direction."""
    grasp_yaw: Tensor
    """Yaw of the gripper in its frame [rad]."""
    faceted: Tensor
    """Whether the gripper's fingers align with its faces."""
    graspable: Tensor
    """Whether a gripper can hold it."""
    draggable: Tensor
    """Whether the stick may drag it."""
    drag_m: Tensor
    """Distance of its center from its contact with the stick [m]; 0 without one."""


@taken_as_constant
def traits_of(entities: EntitySet, device: torch.device) -> Traits:
    """Return the properties of the kinds of some entities, on a device."""
    return _traits_of(entities, device)


@lru_cache(maxsize=32)
def _traits_of(entities: EntitySet, device: torch.device) -> Traits:
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
        entities: Entities, in the order of their numbers.

    Raises:
        DatasetError: An entity in a scene has no number.
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
