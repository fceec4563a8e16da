"""Noise of ReachNet's scene tables in training: simulated errors of perception."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from lemma.core.arguments import Deviation, Share
from lemma.policies.models.reachnet.scene_table import FAR_M, SceneTable


@dataclass(frozen=True)
class Noise:
    """Noise of scene tables from labels, which models the errors of perception."""

    position_m: Deviation = 0.003
    """Standard deviation of positions [m]."""
    yaw_rad: Deviation = 0.02
    """Standard deviation of yaws [rad]."""
    height_m: Deviation = 0.003
    """Standard deviation of heights [m]."""
    base_m: Deviation = 0.004
    """Standard deviation of bases and of radii of reach [m]."""
    unseen: Share = 0.01
    """Share of entities to remove, among those that the sub-task does not need."""


def disturbed(table: SceneTable, noise: Noise, needed: Tensor) -> SceneTable:
    """Return scene tables with simulated errors of perception.

    Args:
        table: True scenes.
        noise: Size of the errors.
        needed: Entities that are never removed, (B, E) bool.
    """

    def jitter(values: Tensor, deviation: float) -> Tensor:
        return values + deviation * torch.randn_like(values)

    missed = (torch.rand_like(table.yaw) < noise.unseen) & ~needed
    present = table.present & ~missed
    xy = jitter(table.xy, noise.position_m)
    return replace(
        table,
        present=present,
        xy=torch.where(present.unsqueeze(-1), xy, FAR_M),
        yaw=torch.where(present, jitter(table.yaw, noise.yaw_rad), 0.0),
        top=torch.where(present, jitter(table.top, noise.height_m), 0.0),
        bases=jitter(table.bases, noise.base_m),
        radii=jitter(table.radii, noise.base_m),
    )
