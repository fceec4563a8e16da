"""The networks of CLIPort: two streams, pick attention, place transport, zoom.

The spatial stream has color and height as input, but not the sentence. The semantic
stream has color and the sentence, which scales and shifts its features at every level
of decoding (FiLM), where features of the spatial stream are added, too.

Attention scores each cell for the pick. Transport crops the surroundings of the pick,
rotates them, and scores each cell and rotation for the place. Cells are coarse; small
networks on the features of a cell predict the offset in it, and the residual of the
yaw's bin.

The zoom crops the surroundings of the place in the gripper's frame and corrects the
pose. The stick touches a cube half a meter from the gripper, so centimeters and degrees
matter. CLIPort has no such step; RVT-2 (Goyal et al., 2024) has a similar one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Count, Depth, Extent, Share, Width, Widths
from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import Batch
from lemma.policies.layers import (
    Network,
    ResidualBlock,
    constant,
    norm,
    upsample_to,
)
from lemma.policies.models.base import MapConfig
from lemma.policies.models.grid import (
    Cells,
    bin_yaws,
    correlate,
    crop_about,
    read_at,
    read_finer,
    seen_from,
    turned,
    wrapped,
)
from lemma.scene.objects.stick import STICK_KIND
from lemma.scene.raster import Raster

STRIDE = 4
"""Cells of the map along a side of a cell of features."""
FINER = 2
"""Cells of a pick or key pose along a side of a cell of features."""
IMAGE_CHANNELS = 8
_SEMANTIC = 5
_HEIGHT_SCALES_M = (0.3, 0.05)
_HEIGHT_LIMIT = 2.0
_LOUDNESS = 3.0
"""Initial scale of the sentence's effect. With a scale of 1 the sentence had no effect
for thousands of steps, and the network learned to pick any cube."""
_READ_WIDTH = 128
_FIRST_SCALE = 1 / 16
_FAR_M = 0.5
_UNIT_M, _UNIT_RAD = 0.03, math.radians(15.0)
_NOISE = (0.03, 0.03, math.radians(10.0))
_GRASP = STICK_KIND.grasp
assert _GRASP is not None
_STICK_M = max(axis.end[0] for axis in STICK_KIND.shell.capsules) - _GRASP.at.x
"""Distance from the stick's grasp to its end [m]."""
_CROP_M = 2 * round(_STICK_M + 0.06, 2)


@dataclass(frozen=True)
class CLIPortConfig(MapConfig):
    """Options of CLIPort."""

    widths: Widths = (32, 64, 128, 224)
    """Channels at 1/4, 1/8, 1/16 and 1/32 of the map's resolution."""
    query_widths: Widths = (32, 64, 96, 128)
    """The same for the network on the crop around the pick."""
    bins: Count = 12
    """Number of bins of yaw, each with a residual."""
    kernel_channels: Width = 8
    """Number of correlated channels."""
    crop: Count = 128
    """Cells along a side of the crops around the pick and around the place."""
    crop_m: Extent = _CROP_M
    """Side of the crops [m]; it should contain the stick for any grasp."""
    zoom: bool = True
    """Whether to correct the place from a crop around it; CLIPort has no such step."""
    text_width: Width = 192
    """Width of a word."""
    text_layers: Depth = 2
    """Transformer layers over the words."""
    word_dropout: Share = 0.0
    """Share of words that are replaced by the unknown word in training; 0, because each
    word of a sub-instruction matters."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not len(self.widths) == len(self.query_widths) == 4:
            raise InvalidConfigError(
                f"widths={self.widths!r}, query_widths={self.query_widths!r}: there "
                "are four levels. Give four numbers of channels to each, such as (32, "
                "64, 128, 224)."
            )
        if self.crop < 2 * STRIDE or self.crop % STRIDE:
            raise InvalidConfigError(
                f"crop={self.crop} is no multiple of {STRIDE}. Take 128."
            )


def image_of(batch: Batch) -> Tensor:
    """Return the input image of the networks.

    Returns:
        (B, 8, rows, columns) float32: color from -1 to 1; height in two scales, one
        for arms and one for objects on the table; coverage; x and y [m].
    """
    rows, columns = batch.height_m.shape[1:]
    device = batch.height_m.device
    cell_m = batch.raster.cell_m
    x = (torch.arange(columns, device=device) + 0.5 - columns / 2) * cell_m
    y = (rows / 2 - 0.5 - torch.arange(rows, device=device)) * cell_m
    like = batch.height_m
    heights = [
        (like / scale).clamp(-_HEIGHT_LIMIT, _HEIGHT_LIMIT)
        for scale in _HEIGHT_SCALES_M
    ]
    rest = [*heights, batch.coverage.float()]
    places = [x.expand_as(like), y[:, None].expand_as(like)]
    rgb = batch.rgb.permute(0, 3, 1, 2).float() / 127.5 - 1.0
    return torch.cat([rgb, torch.stack([*rest, *places], 1)], 1)


class Encoder(Network):
    """Features at 1/4, 1/8, 1/16 and 1/32 of the resolution."""

    def __init__(self, channels_in: int, widths: Sequence[int]) -> None:
        """Make the weights.

        Args:
            channels_in: Channels of the image.
            widths: Channels of each level, from fine to coarse.
        """
        super().__init__()
        # Begin with patches, because convolutions at full resolution cost the most.
        self.stem = nn.Conv2d(channels_in * STRIDE**2, widths[0], 1, bias=False)
        self.stem_norm = norm(widths[0])
        self.levels = nn.ModuleList([ResidualBlock(widths[0], widths[0])])
        for finer, width in pairwise(widths):
            self.levels.append(ResidualBlock(finer, width, stride=2))
        self.last = ResidualBlock(widths[-1], widths[-1])
        self.widths = tuple(widths)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Map (B, channels_in, H, W), with sides divisible by 4, to all levels."""
        x = F.pixel_unshuffle(image, STRIDE)
        x = F.silu(self.stem_norm(self.stem(x)))
        found = []
        for level in self.levels:
            x = level(x)
            found.append(x)
        found[-1] = self.last(found[-1])
        return found


class _Up(nn.Module):
    """Upsample coarse features, add the encoder's features, and convolve."""

    def __init__(self, coarser: int, skip: int, width: int) -> None:
        super().__init__()
        self.coarse = nn.Conv2d(coarser, width, 1, bias=False)
        self.skip = nn.Conv2d(skip, width, 1)
        self.block = ResidualBlock(width, width)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        found: Tensor = self.block(upsample_to(self.coarse(x), skip) + self.skip(skip))
        return found


class FiLM(nn.Module):
    """Scale and shift channels by a vector, such as that of a sentence."""

    def __init__(
        self, vector_width: int, width: int, loudness: float = _LOUDNESS
    ) -> None:
        """Create the map from vectors to factors."""
        super().__init__()
        self.linear = nn.Linear(vector_width, 2 * width)
        with torch.no_grad():
            self.linear.weight.mul_(loudness)

    def forward(self, x: Tensor, vector: Tensor) -> Tensor:
        """Return channels x (B, width, H, W), conditioned on a vector (B, ...)."""
        scale, shift = self.linear(vector)[:, :, None, None].chunk(2, 1)
        found: Tensor = x * (1.0 + scale) + shift
        return found


class _Lateral(nn.Module):
    """A lateral connection from the spatial to the semantic stream."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(2 * width, width, 1)

    def forward(self, semantic: Tensor, spatial: Tensor) -> Tensor:
        return F.silu(self.conv(torch.cat([semantic, spatial], 1)))


class TwoStreams(Network):
    """Two streams from an image and a sentence to features at 1/4 of the resolution."""

    def __init__(self, widths: Sequence[int], sentence_width: int) -> None:
        """Make the weights.

        Args:
            widths: Channels of each level, from fine to coarse.
            sentence_width: Width of the sentence's vector.
        """
        super().__init__()
        self.spatial = Encoder(IMAGE_CHANNELS, widths)
        self.semantic = Encoder(_SEMANTIC, widths)
        self.enter = nn.Conv2d(widths[-1], widths[-1], 1)
        self.spatial_ups = nn.ModuleList()
        self.semantic_ups = nn.ModuleList()
        self.films = nn.ModuleList([FiLM(sentence_width, widths[-1])])
        self.laterals = nn.ModuleList([_Lateral(widths[-1])])
        for level in reversed(range(len(widths) - 1)):
            width, coarser = widths[level], widths[level + 1]
            self.spatial_ups.append(_Up(coarser, width, width))
            self.semantic_ups.append(_Up(coarser, width, width))
            self.films.append(FiLM(sentence_width, width))
            self.laterals.append(_Lateral(width))
        self.width = widths[0]
        self.context_width = widths[-1]

    def forward(self, image: Tensor, sentence: Tensor) -> tuple[Tensor, Tensor]:
        """Return features of an image, conditioned on a sentence.

        Args:
            image: From :func:`image_of`, or a crop of it, (B, 8, H, W).
            sentence: (B, sentence_width).

        Returns:
            Features (B, width, H / 4, W / 4) and the mean of the coarsest ones,
            (B, context_width).
        """
        image = image.contiguous(memory_format=torch.channels_last)
        spatial = self.spatial(image)
        seen = self.semantic(torch.cat([image[:, :3], image[:, 6:]], 1))
        where = spatial[-1]
        what = self.films[0](self.enter(seen[-1]), sentence)
        what = self.laterals[0](what, where)
        context = what.mean((2, 3))
        for i in range(len(self.spatial_ups)):
            level = len(spatial) - 2 - i
            where = self.spatial_ups[i](where, spatial[level])
            what = self.semantic_ups[i](what, seen[level])
            what = self.films[i + 1](what, sentence)
            what = self.laterals[i + 1](what, where)
        return what, context


@dataclass(frozen=True)
class Attention:
    """Output of the pick head."""

    maps: Tensor
    """(B, 1 + extra, rows, columns); the first channel has the logits of the pick."""
    features: Tensor
    """(B, C, rows / 2, columns / 2)."""
    context: Tensor
    """Features of the whole image, (B, D)."""

    @property
    def logits(self) -> Tensor:
        """Logits of the pick's cell, (B, cells), float32."""
        return self.maps[:, 0].flatten(1).float()


@dataclass(frozen=True)
class Fit:
    """Output of the place head."""

    logits: Tensor
    """Logits of the place's rotation and cell, (B, bins, rows, columns), float32."""
    features: Tensor
    """(B, C, rows, columns)."""
    query: Tensor
    """Features of the whole crop, (B, D)."""


Looked = tuple[Tensor, Tensor, Fit]
"""Image, sentence, and output of the place head for them."""


def pick_cells(raster: Raster) -> Cells:
    """Return the cells of picks and key poses."""
    return Cells.of(raster, STRIDE // FINER)


def place_cells(raster: Raster) -> Cells:
    """Return the cells of the place."""
    return Cells.of(raster, STRIDE)


class PickHead(nn.Module):
    """Predicts the pick pose: position and yaw."""

    def __init__(self, config: CLIPortConfig, extra: int) -> None:
        """Make the weights; each cell has ``extra`` further outputs."""
        super().__init__()
        self.streams = TwoStreams(config.widths, config.text_width)
        width = self.streams.width
        self.context_width = self.streams.context_width
        self.maps = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(width, (1 + extra) * FINER**2, 1),
        )
        self.read = reader(width + FINER**2, 2 + 2 * config.bins)
        self.bins = config.bins

    def forward(self, image: Tensor, sentence: Tensor) -> Attention:
        """Return logits and features of the image, (B, 8, rows, columns)."""
        features, context = self.streams(image, sentence)
        maps = F.pixel_shuffle(self.maps(features), FINER)
        return Attention(maps, features, context)

    def at(self, seen: Attention, numbers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the predictions for some cells.

        Args:
            seen: From :meth:`forward`.
            numbers: Numbers of pick cells, (B, K).

        Returns:
            Offsets in the cell, (B, K, 2), logits of the bins of yaw, (B, K, bins),
            and the residual of each bin in widths of a bin, (B, K, bins); float32.
        """
        columns = seen.maps.shape[-1]
        read = read_finer(seen.features, numbers, columns, FINER)
        found = self.read(read).float()
        offsets, bins, residuals = found.split([2, self.bins, self.bins], -1)
        return offsets, bins, residuals


class PlaceHead(nn.Module):
    """Predicts the place pose of the picked object: position and yaw."""

    def __init__(self, config: CLIPortConfig) -> None:
        """Make the weights."""
        super().__init__()
        self.key = TwoStreams(config.widths, config.text_width)
        self.query = TwoStreams(config.query_widths, config.text_width)
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
        """Correlate the crop around the pick with the map, in all rotations.

        Args:
            image: (B, 8, rows, columns).
            sentence: (B, width).
            pick: Gripper's pose where it closes: x, y [m], yaw [rad], (B, 3).
            raster: Raster of the map.
        """
        features, _ = self.key(image, sentence)
        crop = crop_about(image, pick, raster, self.crop, self.crop_m)
        around, query = self.query(crop, sentence)
        # Resample the kernel to cells of the same size as the map's.
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
        """Return the predictions for some cells and bins.

        Args:
            seen: From :meth:`forward`.
            numbers: Numbers of place cells, (B, K).
            bin_numbers: Numbers of the bins of yaw, (B, K).
            pick: As in :meth:`forward`.
            cells: Cells of the place.

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
        parts = [features, query, which, known]
        found = self.read(torch.cat([x.to(features.dtype) for x in parts], -1)).float()
        return found[..., :2], found[..., 2]


def reader(width: int, out: int) -> nn.Sequential:
    """Return a small network from ``width`` features of a cell to ``out`` numbers."""
    return nn.Sequential(
        nn.Linear(width, _READ_WIDTH),
        nn.SiLU(),
        nn.Linear(_READ_WIDTH, _READ_WIDTH),
        nn.SiLU(),
        nn.Linear(_READ_WIDTH, out),
    )


class Zoom(nn.Module):
    """Corrects the place pose from a crop around it."""

    def __init__(self, config: CLIPortConfig) -> None:
        """Make the weights."""
        super().__init__()
        self.streams = TwoStreams(config.query_widths, config.text_width)
        width = self.streams.width + self.streams.context_width
        self.read = reader(width + config.widths[0] + 6, 3)
        self.crop, self.crop_m = config.crop, config.crop_m

    def forward(
        self, seen: Looked, pick: Tensor, place: Tensor, raster: Raster
    ) -> Tensor:
        """Return the correction of a place pose.

        Args:
            seen: Image, sentence, and output of the place head for them.
            pick: Gripper's pose where it closes, (B, 3).
            place: Approximate pose where the motion ends, (B, 3).
            raster: Raster of the map.

        Returns:
            Correction ahead, to the left and counter-clockwise in the gripper's frame,
            (B, 3), in units of some centimeters and degrees; float32.
        """
        image, sentence, fit = seen
        crop = crop_about(image, place, raster, self.crop, self.crop_m)
        around, context = self.streams(crop, sentence)
        # The four central cells.
        row, column = around.shape[-2] // 2, around.shape[-1] // 2
        middle = around[..., row - 1 : row + 1, column - 1 : column + 1].mean((2, 3))
        there = read_at(fit.features, place_cells(raster).holding(place[:, None, :2]))[
            :, 0
        ]
        known = [seen_from(place, pick[:, :2]) / _FAR_M]
        for angle in (pick[:, 2] - place[:, 2], place[:, 2]):
            known.append(torch.stack([angle.cos(), angle.sin()], 1))
        parts = [middle, context, there, torch.cat(known, 1)]
        found: Tensor = self.read(torch.cat([x.to(around.dtype) for x in parts], 1))
        return found.float()

    def corrected(self, place: Tensor, correction: Tensor) -> Tensor:
        """Return a place pose, (B, 3), with a correction from :meth:`forward`."""
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

    def loss(self, seen: Looked, pick: Tensor, place: Tensor, raster: Raster) -> Tensor:
        """Return the loss of corrections of perturbed expert's places, (B,)."""
        tried = place
        if self.training:
            noise = torch.rand_like(place) * 2.0 - 1.0
            tried = place + noise * constant(_NOISE, place.device)
        found = self(seen, pick, tried, raster)
        yaw = wrapped(place[:, 2] - tried[:, 2]) / _UNIT_RAD
        wanted = torch.cat([seen_from(tried, place[:, :2]) / _UNIT_M, yaw[:, None]], 1)
        return F.smooth_l1_loss(found, wanted, reduction="none", beta=0.3).mean(1)
