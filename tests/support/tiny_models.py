"""The smallest models of each kind, each time with the same weights."""

from dataclasses import asdict, replace
from typing import Any

import torch
from batches import RASTER

from lemma.core.arguments import decode
from lemma.policies.models.catalog import MODELS
from lemma.policies.models.reachnet.noise import Noise

_STREAMS: dict[str, Any] = {
    "widths": (16, 16, 24, 32),
    "query_widths": (16, 16, 16, 16),
    "kernel_channels": 4,
    "crop": 16,
    "crop_m": 0.4,
    "text_width": 32,
    "text_layers": 1,
    "cell_m": RASTER.cell_m,
}
_REACHNET: dict[str, Any] = {
    "eye": {"widths": (32, 32), "blocks": 1, "ring_width": 16},
    "reader": {"width": 16, "layers": 1, "heads": 2},
    "planner": {"width": 32, "layers": 1, "heads": 2},
    "noise": asdict(Noise(0.0, 0.0, 0.0, 0.0, 0.0)),
    "draws": 1,
    "cell_m": RASTER.cell_m,
}
OPTIONS: dict[str, dict[str, Any]] = {
    "cliport": _STREAMS,
    "m-cliport": _STREAMS,
    "episodic-transformer": {
        "width": 48,
        "heads": 4,
        "text_layers": 1,
        "layers": 2,
        "channels": (8, 16, 16, 16),
        "blocks": 1,
        "cell_channels": 8,
        "dropout": 0.0,
        "visual_dropout": 0.0,
        "first_view_only": 0.0,
    },
    "reachnet": _REACHNET,
    "team-reachnet": _REACHNET
    | {
        "reader": {**_REACHNET["reader"], "refuses": False},
        "planner": {**_REACHNET["planner"], "dropout": 0.0},
    },
}
"""Options of the models whose input is one map per frame."""


def tiny(name: str, **changes: Any) -> Any:
    """Return a model with new weights; changes of options may leave their ranges."""
    torch.manual_seed(0)
    kind, config = MODELS[name]
    return kind(replace(decode(config, OPTIONS[name]), **changes))
