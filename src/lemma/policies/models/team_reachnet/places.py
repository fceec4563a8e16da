"""Places of things relative to others, as :mod:`lemma.tasks.language.relational` says.

The things are the entities that a goal may name, then the robots by color. The words
are about things of one kind: the nearest cube, the leftmost robot.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.policies.models.team_reachnet.table import TeamTable
from lemma.tasks.language.bank import ORDINALS
from lemma.tasks.language.relational import BETWEEN_M

BY_ONE = 4
"""Number of relations to one other thing: nearest, farthest, left of, right of."""
BY_ORDER = 2 * len(ORDINALS)
"""Number of places in the order from the left, and in that from the right."""


class Places(NamedTuple):
    """Shares of N things in B scenes: 1 for the only one of its kind that fits."""

    by_one: Tensor
    """By relation, thing and other thing, (B, BY_ONE, N, N)."""
    by_two: Tensor
    """That it is between two others, (B, N, N, N)."""
    by_order: Tensor
    """That it has a place in the order of x, (B, BY_ORDER, N)."""


def places_in(table: TeamTable, kinds: Tensor) -> Places:
    """Return the places of the things on tables.

    Args:
        table: B scenes.
        kinds: Number of each thing's kind, (N,); robots are one kind.
    """
    targets = table.entities.stick
    at = torch.cat([table.xy[:, :targets], table.bases], 1)
    there = torch.cat([table.there[:, :targets], table.team], 1)
    x, count = at[..., 0], at.shape[1]
    itself = torch.eye(count, dtype=torch.bool, device=at.device)
    alike = (kinds[:, None] == kinds) & there[:, :, None] & there[:, None] & ~itself
    both = there[:, :, None] & there[:, None] & ~itself
    away = (at[:, :, None] - at[:, None]).norm(dim=-1)
    # Rivals of a thing: others of its kind, but for the thing that it is compared with.
    others = ~alike[:, :, :, None] | itself
    nearest = ((away[:, :, None] <= away[:, None]) | others).all(2)
    farthest = ((away[:, :, None] >= away[:, None]) | others).all(2)
    left, right = x[:, :, None] < x[:, None], x[:, :, None] > x[:, None]
    by_one = torch.stack([nearest, farthest, left, right], 1) & both[:, None]
    before, behind = (alike & right).sum(2), (alike & left).sum(2)
    orders = [
        F.one_hot(n.clamp(max=len(ORDINALS)), 1 + len(ORDINALS))
        for n in (before, behind)
    ]
    by_order = torch.cat([one[..., :-1] for one in orders], -1) * there[..., None]
    return Places(
        _shared(by_one, kinds),
        _shared(_between(at, both)[:, None], kinds)[:, 0],
        by_order.transpose(1, 2).float(),
    )


def _between(at: Tensor, both: Tensor) -> Tensor:
    """Return whether things are between two others, (B, N, N, N) bool."""
    way = at[:, None] - at[:, :, None]
    length = way.norm(dim=-1).clamp(min=1e-6)
    along = way / length[..., None]
    off = (at[:, :, None] - at[:, None])[:, :, :, None]
    ahead = (off * along[:, None]).sum(-1)
    aside = off[..., 0] * along[:, None, ..., 1] - off[..., 1] * along[:, None, ..., 0]
    inside = (ahead > 0.0) & (ahead < length[:, None]) & (aside.abs() < BETWEEN_M)
    found: Tensor = inside & both[:, :, :, None] & both[:, :, None] & both[:, None]
    return found


def _shared(fits: Tensor, kinds: Tensor) -> Tensor:
    """Return 1 for things that fit, divided by their number in each kind.

    Args:
        fits: Whether they fit, (B, ..., N, ...) bool with N in the third dimension.
        kinds: Number of each thing's kind, (N,).
    """
    alike = (kinds[:, None] == kinds).float()
    found = fits.float()
    number = torch.einsum("nm,brm...->brn...", alike, found)
    shares: Tensor = found / number.clamp(min=1.0)
    return shares
