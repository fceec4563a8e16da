"""A second look at the place: what lies around it, as the gripper there would see it.

A stick that shall touch a cube reaches half a metre from the gripper, so that
centimetres and degrees count. Seen from the gripper, the cube is always at the same
place; how far it is from there says how far the gripper is from where it should be.
CLIPort has no such step; RVT-2 (Goyal et al., 2024) zooms in likewise.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.models.cliport.grid import read_at
from lemma.policies.models.cliport.heads import Fit, HeadsConfig, place_cells, reader
from lemma.policies.models.cliport.networks import TwoStreams
from lemma.policies.models.cliport.rotations import crop_about, wrapped
from lemma.scene.raster import Raster

_UNIT_M = 0.03
_UNIT_RAD = math.radians(15.0)
_NOISE_M = 0.03
_NOISE_RAD = math.radians(10.0)
_FAR_M = 0.5
_KNOWN = 6


class Zoom(nn.Module):
    """Corrects where the place head would go."""

    def __init__(self, config: HeadsConfig) -> None:
        """Make the weights."""
        super().__init__()
        self.streams = TwoStreams(config.query_widths, config.sentence_width)
        width = self.streams.width + self.streams.context_width
        self.read = reader(width + config.widths[0] + _KNOWN, 3)
        self.crop, self.crop_m = config.crop, config.crop_m

    def forward(
        self,
        seen: tuple[Tensor, Tensor],
        fit: Fit,
        pick: Tensor,
        place: Tensor,
        raster: Raster,
    ) -> Tensor:
        """Look around a place.

        Args:
            seen: Picture and sentence.
            fit: Input and features of the place head.
            pick: Gripper where it closes, (B, 3).
            place: Gripper where the motion shall end, about, (B, 3).
            raster: Where the cells are.

        Returns:
            How far ahead, to the left and counter-clockwise it should be, (B, 3), in
            units of some centimetres and degrees; float32.
        """
        image, sentence = seen
        crop = crop_about(image, place, raster, self.crop, self.crop_m)
        around, context = self.streams(crop, sentence)
        cells = place_cells(raster)
        there = read_at(fit.features, cells.holding(place[:, None, :2]))[:, 0]
        turn = pick[:, 2] - place[:, 2]
        known = torch.cat(
            [
                _seen_from(place, pick[:, :2]) / _FAR_M,
                torch.stack([turn.cos(), turn.sin()], 1),
                torch.stack([place[:, 2].cos(), place[:, 2].sin()], 1),
            ],
            1,
        )
        kind = around.dtype
        middle = _middle(around)
        found: Tensor = self.read(
            torch.cat([middle, context.to(kind), there.to(kind), known.to(kind)], 1)
        )
        return found.float()

    def corrected(self, place: Tensor, correction: Tensor) -> Tensor:
        """Return a place with what :meth:`forward` said of it, (B, 3)."""
        ahead, left = (correction[:, :2] * _UNIT_M).unbind(1)
        cos, sin = place[:, 2].cos(), place[:, 2].sin()
        return torch.stack(
            [
                place[:, 0] + cos * ahead - sin * left,
                place[:, 1] + sin * ahead + cos * left,
                place[:, 2] + correction[:, 2] * _UNIT_RAD,
            ],
            1,
        )

    def loss(
        self,
        seen: tuple[Tensor, Tensor],
        fit: Fit,
        pick: Tensor,
        place: Tensor,
        raster: Raster,
    ) -> Tensor:
        """Return how wrong the corrections of places near the expert's are, (B,)."""
        tried = place
        if self.training:
            noise = torch.rand_like(place) * 2.0 - 1.0
            tried = place + noise * place.new_tensor([_NOISE_M, _NOISE_M, _NOISE_RAD])
        found = self(seen, fit, pick, tried, raster)
        yaw = wrapped(place[:, 2] - tried[:, 2]) / _UNIT_RAD
        wanted = torch.cat([_seen_from(tried, place[:, :2]) / _UNIT_M, yaw[:, None]], 1)
        return F.smooth_l1_loss(found, wanted, reduction="none", beta=0.3).mean(1)


def _seen_from(pose: Tensor, xy_m: Tensor) -> Tensor:
    """Return positions ahead and to the left of poses [m], (B, 2)."""
    x, y = (xy_m - pose[:, :2]).unbind(1)
    cos, sin = pose[:, 2].cos(), pose[:, 2].sin()
    return torch.stack([cos * x + sin * y, cos * y - sin * x], 1)


def _middle(features: Tensor) -> Tensor:
    """Return the mean of the four cells in the middle, (B, C)."""
    rows, columns = features.shape[-2] // 2, features.shape[-1] // 2
    return features[..., rows - 1 : rows + 1, columns - 1 : columns + 1].mean((2, 3))
