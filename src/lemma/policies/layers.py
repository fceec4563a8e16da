"""Network blocks that several models share.

Normalisation is over groups of channels, never over the batch: with batch statistics a
decision would depend on the other samples of its batch.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.errors import InvalidConfigError

_Function = TypeVar("_Function", bound=Callable[..., Any])

GROUP_CHANNELS = 8
"""Number of channels per group of the normalisation."""


class GroupNorm(nn.GroupNorm):
    """Group normalisation in the precision of its input.

    Autocast would convert features to single precision and back, which takes as long as
    the convolutions. The sums are in single precision anyway.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Normalise (B, channels, H, W)."""
        with torch.autocast(x.device.type, enabled=False):
            weight, bias = self.weight.to(x.dtype), self.bias.to(x.dtype)
            return F.group_norm(x, self.num_groups, weight, bias, self.eps)


def norm(channels: int) -> nn.GroupNorm:
    """Return the normalisation of a feature map."""
    return GroupNorm(max(1, channels // GROUP_CHANNELS), channels)


def taken_as_constant(function: _Function) -> _Function:
    """Mark a function that the compiler calls once, whose result it takes as constant.

    The compiler does not see caches, and would compile what is in them.

    Args:
        function: Function of constants.
    """
    found: _Function = torch.compiler.assume_constant_result(function)  # type: ignore[no-untyped-call]
    return found


@taken_as_constant
def constant(values: tuple[Any, ...], device: torch.device) -> Tensor:
    """Return constants as a tensor, cached per device.

    Copying constants from the CPU makes a GPU wait, and cannot be part of a captured
    step (:class:`lemma.policies.training.captured.CapturedStep`).

    Args:
        values: Numbers in nested tuples of the tensor's shape.
        device: Device of the tensor.
    """
    # The key has the text besides: 1 equals 1.0, but makes a tensor of another type.
    return _constant(values, repr(values), device)


@lru_cache(maxsize=256)
def _constant(values: tuple[Any, ...], _: str, device: torch.device) -> Tensor:
    # Cached, so they must not be inference tensors.
    with torch.inference_mode(False):
        return torch.tensor(values, device=device)


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """Copy a tensor to a device without waiting for it.

    Memory that is not pinned would be copied only after the GPU's work so far.
    """
    if tensor.device.type == device.type:
        return tensor
    return tensor.pin_memory().to(device, non_blocking=True)


class Network(nn.Module):
    """A part of a model that is compiled: it reads tensors, but no texts or names."""


class ResidualBlock(Network):
    """Two 3 x 3 convolutions with a residual connection and an optional stride."""

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
    """Return a feature map, bilinearly upsampled to the height and width of another."""
    return F.interpolate(
        x, size=size_of.shape[-2:], mode="bilinear", align_corners=False
    )


_LONGEST_PERIOD = 10_000.0


class TransformerLayer(nn.Module):
    """Pre-norm transformer layer: self-attention and two linear layers, residual."""

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
            heads: Number of attention heads; it must divide the width.
            hidden: Width between the two linear layers.
            dropout: Probability of dropout in training.
            activation: Activation between the two linear layers.
            drops_hidden: Whether dropout applies between the two linear layers, too.

        Raises:
            InvalidConfigError: The number of heads does not divide the width.
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
        """Map tokens (B, L, width) to tokens of the same shape.

        Args:
            tokens: (B, L, width).
            attends: Attention mask, from each token (row) to tokens (columns),
                (B, L, L) or (B, 1, L) bool, with at least one True in each row; or an
                additive attention bias, (B, heads, L, L) float.
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


def planner_layers(
    width: int, heads: int, dropout: float, layers: int
) -> nn.ModuleList:
    """Return the transformer layers of a planner; see :class:`TransformerLayer`."""
    return nn.ModuleList(
        TransformerLayer(width, heads, 4 * width, dropout, F.silu, drops_hidden=False)
        for _ in range(layers)
    )


def mlp(wide: int, hidden: int, out: int) -> nn.Sequential:
    """Return two linear layers, from a width over a hidden one to another."""
    return nn.Sequential(nn.Linear(wide, hidden), nn.SiLU(), nn.Linear(hidden, out))


def check_heads(width: int, heads: int) -> None:
    """Check that the number of attention heads divides the width.

    Raises:
        InvalidConfigError: It does not.
    """
    if width % heads:
        raise InvalidConfigError(
            f"{heads} heads cannot share a width of {width} evenly. Take a width such "
            f"as {heads * max(1, width // heads)}."
        )


def made_without_numbers() -> bool:
    """Return whether new tensors are on the device "meta", which has sizes only.

    For arithmetic on that device torch loads its compiler, which takes a second.
    """
    return torch.get_default_device().type == "meta"


def drawn(*shape: int) -> nn.Parameter:
    """Return new weights, normal with mean 0 and standard deviation 0.1."""
    return nn.Parameter(nn.init.normal_(torch.empty(shape), std=0.1))


def sinusoids(length: int, width: int) -> Tensor:
    """Return sinusoidal position embeddings, (length, width).

    Args:
        length: Number of positions.
        width: Width of a token; even.
    """
    if made_without_numbers():
        return torch.empty(length, width)
    rates = torch.exp(torch.arange(0, width, 2) * (-math.log(_LONGEST_PERIOD) / width))
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=2).flatten(1)
