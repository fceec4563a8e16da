"""Finding entities in the cells of a pooled image, as a task beside a model's own.

The image network of the original Episodic Transformer had learned to detect objects
before. One that learns from decisions alone hardly sees cubes: a cube covers few
pixels, and its place decides nothing but which robot acts.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.scene.raster import Raster


class CellDetector(nn.Module):
    """Tells from the features of each cell which entities it has, and where in it."""

    def __init__(self, channels: int, entities: int) -> None:
        """Make the weights.

        Args:
            channels: Number of features of a cell.
            entities: Number of entities that may be there.
        """
        super().__init__()
        self.entities = entities
        self.scores = nn.Linear(channels, entities)
        self.offsets = nn.Linear(channels, 2 * entities)
        self.absent = nn.Parameter(torch.zeros(entities))

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return what the cells say.

        Args:
            features: (B, cells, channels), row by row.

        Returns:
            Logarithms of the shares of the cells and of absence, (B, E, cells + 1); and
            the place of each entity in each cell from 0 to 1, columns and rows,
            (B, E, cells, 2).
        """
        scores = self.scores(features).mT
        absent = self.absent[None, :, None].expand(len(scores), -1, -1)
        inside = self.offsets(features).sigmoid()
        shares = torch.cat([scores, absent], 2).float().log_softmax(2)
        return shares, inside.unflatten(2, (self.entities, 2)).transpose(1, 2).float()

    def loss(self, features: Tensor, objects: Tensor, raster: Raster) -> Tensor:
        """Return the mean loss over frames and entities.

        Args:
            features: As for :meth:`forward`, of a square grid over the map.
            objects: Position [m] first, in the world frame, (B, E, n); NaN if absent.
            raster: Raster of the maps.
        """
        shares, inside = self(features)
        x_m, y_m = raster.size_m
        size = objects.new_tensor([x_m, -y_m])
        there = objects[..., 0].isfinite()
        at = torch.where(there.unsqueeze(2), objects[..., :2] / size + 0.5, 0.5)
        # Not by `grid.Cells`: pooled cells need be neither square nor of whole pixels.
        side = math.isqrt(features.shape[1])
        column_row = (at * side).clamp(0.0, side - 1e-4)
        column, row = column_row.floor().long().unbind(2)
        number = row * side + column
        target = torch.where(there, number, side * side)
        missed = F.nll_loss(shares.flatten(0, 1), target.flatten())
        here = number[:, :, None, None].expand(-1, -1, 1, 2)
        off = (inside.gather(2, here).squeeze(2) - column_row % 1.0).abs().sum(2)
        return missed + torch.where(there, off, 0.0).mean()
