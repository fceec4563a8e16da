"""Pick attention and place transport: CLIPort's two halves, with yaws and offsets.

Attention says for each cell whether to pick there. Transport cuts out what lies around
the pick, turns it, and says for each cell and each turn how well it fits there. Cells
are coarse; small networks that read the features of a cell say where in it, and which
yaw near the middle of a bin.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.models.cliport.grid import Cells, read_at
from lemma.policies.models.cliport.networks import STRIDE, TwoStreams
from lemma.policies.models.cliport.rotations import (
    bin_yaws,
    crop_about,
    turned,
    wrapped,
)
from lemma.scene.raster import Raster

_FINER = 2
"""The pick has so many cells along a side of a cell of features."""
_READ_WIDTH = 128
_FIRST_SCALE = 1 / 16
_FAR_M = 0.5


@dataclass(frozen=True)
class HeadsConfig:
    """Sizes of the networks."""

    widths: Sequence[int]
    """Channels of the pick and the key network, from fine to coarse."""
    query_widths: Sequence[int]
    """Channels of the network that sees the crop."""
    sentence_width: int
    bins: int
    """Number of bins of yaw, for pick and place; each is refined by a residual."""
    kernel_channels: int
    """Channels that are correlated."""
    crop: int
    """Cells along a side of the crop; a multiple of 4."""
    crop_m: float
    """Side of the crop [m]."""
    extra_channels: int = 0
    """More channels of the pick head."""


@dataclass(frozen=True)
class Attention:
    """Output of the pick head."""

    maps: Tensor
    """(B, 1 + extra, rows, columns): first how much to pick there."""
    features: Tensor
    """(B, C, rows / 2, columns / 2)."""
    context: Tensor
    """(B, D): of the picture as a whole."""

    @property
    def logits(self) -> Tensor:
        """How much to pick in each cell, (B, cells), float32."""
        return self.maps[:, 0].flatten(1).float()


@dataclass(frozen=True)
class Fit:
    """Output of the place head."""

    logits: Tensor
    """How well what is picked fits, (B, bins, rows, columns), float32."""
    features: Tensor
    """(B, C, rows, columns)."""
    query: Tensor
    """(B, D): of the crop as a whole."""


def pick_cells(raster: Raster) -> Cells:
    """Return the cells in which something is picked."""
    return Cells.of(raster, STRIDE // _FINER)


def place_cells(raster: Raster) -> Cells:
    """Return the cells in which something is placed."""
    return Cells.of(raster, STRIDE)


class PickHead(nn.Module):
    """Predicts the pick pose: position and yaw."""

    def __init__(self, config: HeadsConfig) -> None:
        """Make the weights."""
        super().__init__()
        self.streams = TwoStreams(config.widths, config.sentence_width)
        width = self.streams.width
        self.context_width = self.streams.context_width
        self.maps = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(width, (1 + config.extra_channels) * _FINER**2, 1),
        )
        self.read = reader(width + _FINER**2, 2 + 2 * config.bins)
        self.bins = config.bins

    def forward(self, image: Tensor, sentence: Tensor) -> Attention:
        """Look at the whole picture, (B, 8, rows, columns)."""
        features, context = self.streams(image, sentence)
        maps = F.pixel_shuffle(self.maps(features), _FINER)
        return Attention(maps, features, context)

    def at(self, seen: Attention, numbers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Say more about some cells.

        Args:
            seen: From :meth:`forward`.
            numbers: Numbers of pick cells, (B, K).

        Returns:
            Offsets in the cell, (B, K, 2), logits of the bins of yaw, (B, K, bins),
            and residuals for each of them in widths of a bin, (B, K, bins); float32.
        """
        columns = seen.maps.shape[-1]
        row, column = numbers // columns, numbers % columns
        coarse = (row // _FINER) * seen.features.shape[-1] + column // _FINER
        part = (row % _FINER) * _FINER + column % _FINER
        features = read_at(seen.features, coarse)
        which = F.one_hot(part, _FINER**2).to(features.dtype)
        found = self.read(torch.cat([features, which], -1)).float()
        offsets, bins, residuals = found.split([2, self.bins, self.bins], -1)
        return offsets, bins, residuals


class PlaceHead(nn.Module):
    """Predicts the place pose of the picked object: position and yaw."""

    def __init__(self, config: HeadsConfig) -> None:
        """Make the weights."""
        super().__init__()
        self.key = TwoStreams(config.widths, config.sentence_width)
        self.query = TwoStreams(config.query_widths, config.sentence_width)
        width, channels = self.key.width, config.kernel_channels
        self.to_key = nn.Conv2d(width, channels, 1)
        self.to_kernel = nn.Conv2d(self.query.width, channels, 1)
        # Scores of places that do not depend on the held object.
        self.alone = nn.Conv2d(width, config.bins, 1)
        self.scale = nn.Parameter(torch.tensor(_FIRST_SCALE))
        query = self.query.context_width
        self.read = reader(width + query + config.bins + 4, 3)
        self.bins, self.crop, self.crop_m = config.bins, config.crop, config.crop_m

    def forward(
        self, image: Tensor, sentence: Tensor, pick: Tensor, raster: Raster
    ) -> Fit:
        """Try what is picked everywhere, turned in all ways.

        Args:
            image: (B, 8, rows, columns).
            sentence: (B, width).
            pick: Gripper where it closes: x, y [m], yaw [rad], (B, 3).
            raster: Where the cells are.
        """
        features, _ = self.key(image, sentence)
        crop = crop_about(image, pick, raster, self.crop, self.crop_m)
        around, query = self.query(crop, sentence)
        # A kernel has cells of the same size as the map that it is slid over.
        kernels = turned(
            self.to_kernel(around).float(),
            bin_yaws(self.bins, image.device),
            self.crop_m / (self.crop * raster.cell_m),
        )
        fits = correlate(self.to_key(features), kernels) * self.scale
        return Fit(fits + self.alone(features).float(), features, query)

    def at(
        self,
        seen: Fit,
        numbers: Tensor,
        bin_numbers: Tensor,
        pick: Tensor,
        cells: Cells,
    ) -> tuple[Tensor, Tensor]:
        """Say more about some cells and bins.

        Args:
            seen: From :meth:`forward`.
            numbers: Numbers of place cells, (B, K).
            bin_numbers: Numbers of the bins of yaw, (B, K).
            pick: As in :meth:`forward`.
            cells: Where the cells are.

        Returns:
            Offsets in the cell, (B, K, 2), and residuals of yaw in widths of a bin,
            (B, K); float32.
        """
        features = read_at(seen.features, numbers)
        query = seen.query[:, None].expand(-1, numbers.shape[1], -1)
        yaws = bin_yaws(self.bins, pick.device)[bin_numbers]
        turn = wrapped(pick[:, None, 2] - yaws)
        way = (pick[:, None, :2] - cells.centres(numbers)) / _FAR_M
        known = torch.cat([way, turn.cos()[..., None], turn.sin()[..., None]], -1)
        which = F.one_hot(bin_numbers, self.bins)
        kind = features.dtype
        found = self.read(
            torch.cat([features, query.to(kind), which.to(kind), known.to(kind)], -1)
        ).float()
        return found[..., :2], found[..., 2]


def reader(width: int, out: int) -> nn.Sequential:
    """Return the small network that reads the features of a cell."""
    return nn.Sequential(
        nn.Linear(width, _READ_WIDTH),
        nn.SiLU(),
        nn.Linear(_READ_WIDTH, _READ_WIDTH),
        nn.SiLU(),
        nn.Linear(_READ_WIDTH, out),
    )


def correlate(key: Tensor, kernels: Tensor) -> Tensor:
    """Correlate each sample's map with each of its kernels, by their spectra.

    The kernels see a metre of table: sliding them over the map would take far longer.

    Args:
        key: (B, C, rows, columns).
        kernels: (B, R, C, s, s) with s odd.

    Returns:
        (B, R, rows, columns) float32: how well the kernel fits with its middle on the
        cell; nothing lies outside the map.
    """
    rows, columns = key.shape[-2:]
    half = kernels.shape[-1] // 2
    # Values that wrap around must fall into the padding.
    size = (_fast(rows + half), _fast(columns + half))
    with torch.autocast(key.device.type, enabled=False):
        key_spectrum = torch.fft.rfft2(key.float(), s=size)
        kernel_spectra = torch.fft.rfft2(kernels.float(), s=size)
        product = (key_spectrum[:, None] * kernel_spectra.conj()).sum(2)
        fits = torch.fft.irfft2(product, s=size)
    return torch.roll(fits, (half, half), (-2, -1))[..., :rows, :columns]


def _fast(least: int) -> int:
    """Return the next number that has no prime factors but 2, 3 and 5."""
    size = least
    while True:
        rest = size
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return size
        size += 1
