"""ReachNet's memory: things that something hides now, but not in an earlier view.

The map is fused from cameras above the robots, so arms hide things. All views since the
episode began are inputs of a decision. Of a thing that is not seen now, the memory has
the likeliest place in the views since it was moved.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from lemma.policies.interfaces import PolicyInput
from lemma.policies.models.reachnet.scene_table import SceneTable, numbered
from lemma.policies.models.view_cache import ViewCache
from lemma.tasks.subtask import Primitive, SubTask

_NOTICED = 0.03
"""Probability from which a thing counts for the reader, which then knows which colors
are there."""
_SURE = 0.5
_FAINT = 0.03
"""Probability from which a thing counts as present if the instruction names it."""
_AROUND_M = 0.01
"""Error of places of hardly visible things [m]."""
_LEVEL_M = 0.02
"""Error of heights [m]."""
_DRAGS = (Primitive.HOOK, Primitive.POKE)
_PLACES = ("xy", "yaw", "top")


@dataclass(frozen=True, eq=False)
class Sighting:
    """Likeliest places of all entities in B views."""

    table: SceneTable
    """The scenes as if all entities were there; only those seen now are ``present``."""
    shares: Tensor
    """Probability that each is seen at its place, (B, E)."""
    ever: Tensor
    """The same in any view of the episode, wherever it lay, (B, E)."""

    @property
    def noticed(self) -> Tensor:
        """Whether the reader takes each for present, (B, E) bool."""
        return self.ever >= _NOTICED

    def rows(self, index: Tensor) -> "Sighting":
        """Return some of the views."""
        return Sighting(self.table.rows(index), self.shares[index], self.ever[index])

    @classmethod
    def joined(cls, sightings: "Sequence[Sighting]") -> "Sighting":
        """Concatenate sightings."""
        return cls(
            SceneTable.joined([one.table for one in sightings]),
            torch.cat([one.shares for one in sightings]),
            torch.cat([one.ever for one in sightings]),
        )

    def table_with(self, named: Tensor) -> SceneTable:
        """Return the scenes with what is seen, remembered, or faint but named.

        A thing under another one counts as absent, as in training.

        Args:
            named: Numbers of entities of which the instruction says that they are
                there, (B, N) int64; others than those of entities count for nothing.
        """
        faint = numbered(named, self.shares.shape[1]) & (self.shares >= _FAINT)
        there = (self.shares >= _SURE) | faint
        seen = self.table.present
        return self.table.showing(seen | (there & ~self._covered()))

    def _covered(self) -> Tensor:
        """Return whether something that is seen lies on each place, (B, E) bool."""
        table, traits = self.table, self.table.traits
        upper = table.xy[:, : table.cargo]
        apart = (table.xy[:, :, None] - upper[:, None]).norm(dim=-1)
        bottom_m = (table.top - traits.height_m)[:, : table.cargo]
        over = bottom_m[:, None] > traits.height_m[:, None] - _LEVEL_M
        near = apart < traits.support_m[:, None] + _AROUND_M
        itself = torch.eye(*apart.shape[1:], dtype=torch.bool, device=apart.device)
        seen = table.present[:, None, : table.cargo] & ~itself
        covered: Tensor = (near & over & seen).any(-1)
        return covered


class Memory(ViewCache[Sighting]):
    """What views show, as long as these are inputs of decisions."""

    def look(
        self,
        inputs: Sequence[PolicyInput],
        see: Callable[[list[PolicyInput]], Iterable[Sighting]],
    ) -> None:
        """Look at all views of inputs that are new.

        Args:
            inputs: Inputs of a policy.
            see: Returns what the present views of inputs show, in batches.
        """
        new = {
            view: replace(one, view=view, past=())
            for one in inputs
            for view in one.views
            if view not in self
        }
        if new:
            found = Sighting.joined([*see([*new.values()])])
            rows = torch.arange(len(new), device=found.shares.device)
            self.update(zip(new, map(found.rows, rows[:, None]), strict=True))

    def recall(self, given: PolicyInput) -> Sighting:
        """Return what the present view shows, with what earlier ones showed.

        Each entity has its place in the last view in which it is seen, or else in that
        in which it is likeliest, of those since it was moved.
        """
        views = Sighting.joined([self[view] for view in given.views])
        table, shares, count = views.table, views.shares, len(views.shares)
        moved = torch.zeros(shares.shape, dtype=torch.bool)
        for row, step in enumerate(given.past):
            moved[: row + 1] |= _moved(step.subtask, table)
        shares = shares.masked_fill(moved.to(shares.device), 0.0)
        order = torch.arange(1, count + 1, device=shares.device)[:, None]
        sure = (shares >= _SURE) * order
        best = torch.where(sure.any(0), sure.argmax(0), shares.argmax(0))
        which = torch.arange(len(best), device=best.device)
        now = table.rows(order[-1] - 1)
        places = {name: getattr(table, name)[best, which][None] for name in _PLACES}
        ever = views.ever.amax(0, keepdim=True)
        return Sighting(replace(now, **places), shares[best, which][None], ever)


def _moved(subtask: SubTask, table: SceneTable) -> Tensor:
    """Return whether a sub-task moves each entity, or tries to, (E,) bool."""
    names = {subtask.pick}
    if subtask.primitive in _DRAGS:
        names.add(subtask.place)
    return torch.tensor([name in names for name in table.entities.names])
