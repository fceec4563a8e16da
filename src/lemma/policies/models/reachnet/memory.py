"""ReachNet's memory: things that something hides now, but not in an earlier view.

The map is fused from cameras above the robots, so arms hide things. All views since the
episode began are inputs of a decision. Of a thing that is not seen now, the memory has
the place where it was seen last, or where a sub-task has put it since.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from lemma.motion.outcome import REFUSED, Outcome
from lemma.policies.interfaces import PastStep, PolicyInput
from lemma.policies.models.reachnet.scene_table import SceneTable, numbered
from lemma.policies.models.view_cache import ViewCache
from lemma.tasks.subtask import Primitive

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
_UNMOVED = REFUSED - {Outcome.NOTHING_TO_PICK}
"""Outcomes after which everything is where it was. Where there is nothing to pick, the
thing that was looked for is not."""


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
        """Return whether something lies on each place, (B, E) bool."""
        table, traits, cargo = self.table, self.table.traits, self.table.cargo
        known = table.present | (self.shares >= _SURE)
        upper = table.xy[:, :cargo]
        apart = (table.xy[:, :, None] - upper[:, None]).norm(dim=-1)
        # Faint things are taken to lie on the table: the map has the top of another one
        # where that hides them.
        top_m = torch.where(known & (table.top > 0.0), table.top, traits.height_m)
        bottom_m = (table.top - traits.height_m)[:, :cargo]
        over = bottom_m[:, None] > top_m[:, :, None] - _LEVEL_M
        near = apart < traits.support_m[:, None] + _AROUND_M
        itself = torch.eye(*apart.shape[1:], dtype=torch.bool, device=apart.device)
        covered: Tensor = (near & over & known[:, None, :cargo] & ~itself).any(-1)
        return covered


class Memory(ViewCache[Sighting]):
    """Sightings of views, as long as these are inputs of decisions."""

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
        """Return what the present view shows, with what is known from before.

        Each entity has its place in the last view in which it is seen, or the place to
        which it was moved since, or else its likeliest place since it was moved.
        """
        first, *views = given.views
        found = self[first]
        for step, view in zip(given.past, views, strict=True):
            found = _later(_after(found, step), self[view])
        return found


def _after(seen: Sighting, step: PastStep) -> Sighting:
    """Return what is known after a sub-task, before the next view."""
    subtask, table, shares = step.subtask, seen.table, seen.shares.clone()
    names = table.entities.names
    if step.outcome in _UNMOVED:
        return seen
    moved = {subtask.pick} | ({subtask.place} if subtask.primitive in _DRAGS else set())
    shares[:, [names.index(name) for name in moved if name in names]] = 0.0
    if (
        step.outcome == Outcome.SUCCESS
        and subtask.primitive == Primitive.MOVE
        and {subtask.pick, subtask.place} <= {*names}
    ):
        top, bottom = names.index(subtask.pick), names.index(subtask.place)
        xy, top_m, height_m = table.xy.clone(), table.top.clone(), table.traits.height_m
        low_m = top_m[:, bottom] if bottom < table.cargo else height_m[bottom]
        top_m[:, top] = low_m + height_m[top]
        xy[:, top] = xy[:, bottom]
        shares[:, top] = shares[:, bottom]
        table = replace(table, xy=xy, top=top_m)
    return replace(seen, table=table, shares=shares)


def _later(known: Sighting, seen: Sighting) -> Sighting:
    """Return what is known with the next view."""
    newer = (seen.shares >= _SURE) | (seen.shares >= known.shares)
    old, new = known.table, seen.table
    table = replace(
        new,
        xy=torch.where(newer[..., None], new.xy, old.xy),
        yaw=torch.where(newer, new.yaw, old.yaw),
        top=torch.where(newer, new.top, old.top),
    )
    shares = torch.where(newer, seen.shares, known.shares)
    return Sighting(table, shares, torch.maximum(known.ever, seen.ever))
