"""The two-stream networks of CLIPort, slim: where things are, and what they are.

The spatial stream sees color and height and not the sentence; the semantic stream sees
color and the sentence, which scales and shifts its features at every level of decoding.
Features of the spatial stream are added to it at every level of decoding.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import Batch
from lemma.policies.layers import Network, ResidualBlock, norm, upsample_to

STRIDE = 4
"""Cells of the map along a side of a cell of features."""
IMAGE_CHANNELS = 8
_SEMANTIC = (0, 1, 2, 6, 7)
_HEIGHT_SCALES_M = (0.3, 0.05)
_HEIGHT_LIMIT = 2.0
_LOUDNESS = 3.0
"""First scale of the sentence's effect. With a scale of 1 it stayed without effect for
thousands of steps: a network that picks any cube hardly learns colors any more."""


def image_of(batch: Batch) -> Tensor:
    """Return what is seen as a picture for the networks.

    Returns:
        (B, 8, rows, columns) float32: color from -1 to 1; height in two scales, one
        for arms and one for what lies on the table; coverage; x and y [m].
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


class Encoder(nn.Module):
    """Features at a quarter, an eighth, a 16th and a 32nd of the resolution."""

    def __init__(self, channels_in: int, widths: Sequence[int]) -> None:
        """Make the weights.

        Args:
            channels_in: Channels of the picture.
            widths: Channels of each level, from fine to coarse.
        """
        super().__init__()
        # Patches first: convolutions of few channels at full resolution cost most.
        self.stem = nn.Conv2d(channels_in * STRIDE**2, widths[0], 1, bias=False)
        self.stem_norm = norm(widths[0])
        self.levels = nn.ModuleList([ResidualBlock(widths[0], widths[0])])
        for finer, width in pairwise(widths):
            self.levels.append(ResidualBlock(finer, width, stride=2))
        self.last = ResidualBlock(widths[-1], widths[-1])
        self.widths = tuple(widths)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Map (B, channels_in, H, W), sides divisible by 4, to all levels."""
        x = F.pixel_unshuffle(image, STRIDE)
        x = F.silu(self.stem_norm(self.stem(x)))
        found = []
        for level in self.levels:
            x = level(x)
            found.append(x)
        found[-1] = self.last(found[-1])
        return found


class _Up(nn.Module):
    """Enlarge coarse features, add what the encoder saw there, and look around."""

    def __init__(self, coarser: int, skip: int, width: int) -> None:
        super().__init__()
        self.coarse = nn.Conv2d(coarser, width, 1, bias=False)
        self.skip = nn.Conv2d(skip, width, 1)
        self.block = ResidualBlock(width, width)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        found: Tensor = self.block(upsample_to(self.coarse(x), skip) + self.skip(skip))
        return found


class _FiLM(nn.Module):
    """Scale and shift channels by what a sentence says."""

    def __init__(self, sentence_width: int, width: int) -> None:
        super().__init__()
        self.linear = nn.Linear(sentence_width, 2 * width)
        with torch.no_grad():
            self.linear.weight.mul_(_LOUDNESS)

    def forward(self, x: Tensor, sentence: Tensor) -> Tensor:
        scale, shift = self.linear(sentence)[:, :, None, None].chunk(2, 1)
        found: Tensor = x * (1.0 + scale) + shift
        return found


class _Lateral(nn.Module):
    """Let what one stream decoded flow into the other."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(2 * width, width, 1)

    def forward(self, semantic: Tensor, spatial: Tensor) -> Tensor:
        return F.silu(self.conv(torch.cat([semantic, spatial], 1)))


class TwoStreams(Network):
    """A picture and a sentence in, features at a quarter of the resolution out."""

    def __init__(self, widths: Sequence[int], sentence_width: int) -> None:
        """Make the weights.

        Args:
            widths: Channels of each level, from fine to coarse.
            sentence_width: Width of the sentence's vector.
        """
        super().__init__()
        self.spatial = Encoder(IMAGE_CHANNELS, widths)
        self.semantic = Encoder(len(_SEMANTIC), widths)
        self.enter = nn.Conv2d(widths[-1], widths[-1], 1)
        self.spatial_ups = nn.ModuleList()
        self.semantic_ups = nn.ModuleList()
        self.films = nn.ModuleList([_FiLM(sentence_width, widths[-1])])
        self.laterals = nn.ModuleList([_Lateral(widths[-1])])
        for level in reversed(range(len(widths) - 1)):
            width, coarser = widths[level], widths[level + 1]
            self.spatial_ups.append(_Up(coarser, width, width))
            self.semantic_ups.append(_Up(coarser, width, width))
            self.films.append(_FiLM(sentence_width, width))
            self.laterals.append(_Lateral(width))
        self.width = widths[0]
        self.context_width = widths[-1]

    def forward(self, image: Tensor, sentence: Tensor) -> tuple[Tensor, Tensor]:
        """Look at a picture with a sentence in mind.

        Args:
            image: From :func:`image_of`, or cut out of it, (B, 8, H, W).
            sentence: (B, sentence_width).

        Returns:
            Features (B, width, H / 4, W / 4) and the mean of the coarsest ones,
            (B, context_width).
        """
        image = image.contiguous(memory_format=torch.channels_last)
        spatial = self.spatial(image)
        seen = self.semantic(image[:, _SEMANTIC])
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
