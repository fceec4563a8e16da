from dataclasses import replace

import torch

from lemma.policies.models.episodic_transformer import (
    EpisodicTransformer,
    EpisodicTransformerConfig,
)

TINY = EpisodicTransformerConfig(
    width=48,
    heads=4,
    text_layers=1,
    layers=2,
    channels=(8, 16, 16, 16),
    blocks=1,
    cell_channels=8,
    dropout=0.0,
    visual_dropout=0.0,
    first_view_only=0.0,
)


def tiny(**options: float) -> EpisodicTransformer:
    torch.manual_seed(0)
    return EpisodicTransformer(replace(TINY, **options))  # type: ignore[arg-type]
