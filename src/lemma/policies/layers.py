"""Convolutional blocks that several models are made of.

Normalisation is over groups of channels, never over the batch: a batch statistic would
make a decision depend on what else is decided at the same time.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.errors import InvalidConfigError

GROUP_CHANNELS = 8
"""Channels that are normalised together."""


class GroupNorm(nn.GroupNorm):
    """Group normalisation that stays in the precision of what it is given.

    Autocast would turn features to single precision and back, which takes as long as
    the convolutions; sums are in single precision in any case.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Normalise (B, channels, H, W)."""
        with torch.autocast(x.device.type, enabled=False):
            weight, bias = self.weight.to(x.dtype), self.bias.to(x.dtype)
            return F.group_norm(x, self.num_groups, weight, bias, self.eps)


def norm(channels: int) -> nn.GroupNorm:
    """Return the normalisation of a feature map."""
    return GroupNorm(max(1, channels // GROUP_CHANNELS), channels)


def constant(values: tuple[Any, ...], device: torch.device) -> Tensor:
    """Return fixed numbers as a tensor, made once for each device.

    A GPU waits for numbers that come from the CPU, and they cannot be part of a
    captured step (:class:`lemma.policies.training.captured.CapturedStep`).

    Args:
        values: Numbers, nested as the shape is.
        device: Where they shall be.
    """
    # Whole numbers equal fractions as keys, and not as tensors.
    return _constant(values, repr(values), device)


@lru_cache(maxsize=256)
def _constant(values: tuple[Any, ...], _: str, device: torch.device) -> Tensor:
    # Cached, so they must not be inference tensors.
    with torch.inference_mode(False):
        return torch.tensor(values, device=device)


class Network(nn.Module):
    """Maps tensors to tensors, by nothing else: such parts of a model are compiled."""


class ResidualBlock(Network):
    """Two 3 x 3 convolutions and a shortcut; the first may halve the resolution."""

    def __init__(self, channels_in: int, channels: int, stride: int = 1) -> None:
        """Make the weights.

        Args:
            channels_in: Channels of the input.
            channels: Channels of the output.
            stride: 1, or 2 to halve the resolution.
        """
        super().__init__()
        self.first = nn.Conv2d(channels_in, channels, 3, stride, 1, bias=False)
        self.first_norm = norm(channels)
        self.second = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.second_norm = norm(channels)
        self.shortcut = (
            nn.Identity()
            if stride == 1 and channels_in == channels
            else nn.Conv2d(channels_in, channels, 1, stride, bias=False)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, channels_in, H, W) to (B, channels, H / stride, W / stride)."""
        y = F.silu(self.first_norm(self.first(x)))
        y = self.second_norm(self.second(y))
        out: Tensor = F.silu(y + self.shortcut(x))
        return out


def upsample_to(x: Tensor, size_of: Tensor) -> Tensor:
    """Return a feature map, bilinearly enlarged to the size of another."""
    return F.interpolate(
        x, size=size_of.shape[-2:], mode="bilinear", align_corners=False
    )


_LONGEST_PERIOD = 10_000.0


class TransformerLayer(nn.Module):
    """Self-attention and two linear layers, each added to what it was given."""

    def __init__(
        self,
        width: int,
        heads: int,
        hidden: int,
        dropout: float = 0.1,
        activation: Callable[[Tensor], Tensor] = F.gelu,
        *,
        drops_hidden: bool = True,
    ) -> None:
        """Make the weights.

        Args:
            width: Width of a token.
            heads: Number of heads of the attention; they share the width evenly.
            hidden: Width between the two linear layers.
            dropout: Share of values that are left out in training.
            activation: Between the two linear layers.
            drops_hidden: Whether values are left out there, too.

        Raises:
            InvalidConfigError: The heads cannot share the width.
        """
        super().__init__()
        check_heads(width, heads)
        self.heads = heads
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.hidden_norm = nn.LayerNorm(width)
        self.hidden_in = nn.Linear(width, hidden)
        self.hidden_out = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)
        self.activation, self.drops_hidden = activation, drops_hidden

    def forward(self, tokens: Tensor, attends: Tensor) -> Tensor:
        """Map tokens (B, L, width) to as many.

        Args:
            tokens: (B, L, width).
            attends: Which tokens (columns) each token (row) looks at, (B, L, L) or
                (B, 1, L) bool, at least one in each row; or what is added to their
                weights, (B, heads, L, L).
        """
        tokens = tokens + self.dropout(
            self._attention(self.attention_norm(tokens), attends)
        )
        hidden = self.activation(self.hidden_in(self.hidden_norm(tokens)))
        hidden = self.dropout(hidden) if self.drops_hidden else hidden
        out: Tensor = tokens + self.dropout(self.hidden_out(hidden))
        return out

    def _attention(self, x: Tensor, attends: Tensor) -> Tensor:
        count, length, width = x.shape
        parts = self.query_key_value(x).view(count, length, 3, self.heads, -1)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        mask = attends if attends.dim() == 4 else attends.unsqueeze(1)
        if mask.is_floating_point():
            mask = mask.to(query.dtype)
        mixed = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        joined = mixed.transpose(1, 2).reshape(count, length, width)
        out: Tensor = self.attention_out(joined)
        return out


def check_heads(width: int, heads: int) -> None:
    """Check that the heads of an attention share its width evenly.

    Raises:
        InvalidConfigError: They do not.
    """
    if width % heads:
        raise InvalidConfigError(
            f"{heads} heads cannot share a width of {width} evenly. Take a width such "
            f"as {heads * max(1, width // heads)}."
        )


def made_without_numbers() -> bool:
    """Return whether tensors are being made on "meta", for the sake of their sizes.

    For arithmetic there, torch would load its compiler, which takes a second.
    """
    return torch.get_default_device().type == "meta"


def drawn(*shape: int) -> nn.Parameter:
    """Return new weights from a normal distribution, mostly within 0.1 of zero."""
    return nn.Parameter(nn.init.normal_(torch.empty(shape), std=0.1))


def sinusoids(length: int, width: int) -> Tensor:
    """Return what is added to tokens to tell their places, (length, width).

    Args:
        length: Number of places.
        width: Width of a token; even.
    """
    if made_without_numbers():
        return torch.empty(length, width)
    rates = torch.exp(torch.arange(0, width, 2) * (-math.log(_LONGEST_PERIOD) / width))
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=2).flatten(1)
