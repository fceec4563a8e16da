"""Layers of a transformer, normalised before each part."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

_LONGEST_PERIOD = 10_000.0


class TransformerLayer(nn.Module):
    """Self-attention and two linear layers, each added to what it was given."""

    def __init__(
        self, width: int, heads: int, hidden: int, dropout: float = 0.1
    ) -> None:
        """Make the weights.

        Args:
            width: Of a token.
            heads: Of the attention; they share the width evenly.
            hidden: Width between the two linear layers.
            dropout: Share of values that are left out in training.
        """
        super().__init__()
        self.heads = heads
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.hidden_norm = nn.LayerNorm(width)
        self.hidden_in = nn.Linear(width, hidden)
        self.hidden_out = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, tokens: Tensor, attends: Tensor) -> Tensor:
        """Map tokens (B, L, width) to as many.

        Args:
            tokens: (B, L, width).
            attends: Which tokens (columns) each token (row) looks at, (B, L, L) or
                (B, 1, L) bool; at least one in each row.
        """
        tokens = tokens + self.dropout(
            self._attention(self.attention_norm(tokens), attends)
        )
        hidden = F.gelu(self.hidden_in(self.hidden_norm(tokens)))
        out: Tensor = tokens + self.dropout(self.hidden_out(self.dropout(hidden)))
        return out

    def _attention(self, x: Tensor, attends: Tensor) -> Tensor:
        count, length, width = x.shape
        parts = self.query_key_value(x).view(count, length, 3, self.heads, -1)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(
            query, key, value, attn_mask=attends.unsqueeze(1)
        )
        joined = mixed.transpose(1, 2).reshape(count, length, width)
        out: Tensor = self.attention_out(joined)
        return out


def sinusoids(length: int, width: int) -> Tensor:
    """Return what is added to tokens to tell their places, (length, width).

    Args:
        length: Number of places.
        width: Of a token; even.
    """
    rates = torch.exp(torch.arange(0, width, 2) * (-math.log(_LONGEST_PERIOD) / width))
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=2).flatten(1)
