"""A model that is next to nothing, for tests of what surrounds models."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import PRIMITIVES, Batch
from lemma.policies.models.base import MODELS, Model
from lemma.policies.training.config import TrainingConfig
from lemma.policies.weights_file import WeightsMetadata, write_weights

NAME = "tiny"


@dataclass(frozen=True)
class TinyConfig:
    """Options of the model."""

    width: int = 8
    dropout: float = 0.1


class Tiny(Model):
    """Tells the primitive from the mean color, joints and length of the sentence."""

    selection = "primitive"

    def __init__(self, config: TinyConfig) -> None:
        super().__init__()
        self.config = config
        self.first = nn.Linear(3 + 1 + 12 + 1, config.width)
        self.norm = nn.LayerNorm(config.width)
        self.dropout = nn.Dropout(config.dropout)
        self.last = nn.Linear(config.width, len(PRIMITIVES))
        self.seen: Tensor
        self.register_buffer("seen", torch.zeros((), dtype=torch.int64))

    def forward(self, batch: Batch) -> Tensor:
        lengths = batch.height_m.new_tensor([len(t) for t in batch.instructions])
        features = torch.cat(
            [
                batch.rgb.float().mean((1, 2)) / 255.0,
                batch.height_m.mean((1, 2))[:, None],
                batch.joints.flatten(1),
                lengths[:, None] / 50.0,
            ],
            1,
        )
        hidden = self.norm(torch.tanh(self.first(features)))
        logits: Tensor = self.last(self.dropout(hidden))
        return logits

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        assert batch.labels is not None
        self.seen.add_(len(batch))
        logits = self(batch).float()
        return {"primitive": F.cross_entropy(logits, batch.labels.decision[:, 1])}

    def score(self, batch: Batch) -> dict[str, Tensor]:
        assert batch.labels is not None
        chance = self(batch).float().softmax(-1)
        right = chance.gather(1, batch.labels.decision[:, 1:2])[:, 0]
        stop = batch.labels.decision[:, 0] < 0
        return {"primitive": right, "going": right.masked_fill(stop, torch.nan)}


@dataclass(frozen=True)
class TinyEpisodesConfig(TinyConfig):
    """Options of the model that is given whole episodes."""


class TinyEpisodes(Tiny):
    """The same, trained on episodes."""

    unit: ClassVar[Literal["frame", "episode"]] = "episode"


def config(data: Path, out: Path, **options: Any) -> TrainingConfig:
    """Return a short training of it, with other options where they are given."""
    given: dict[str, Any] = {
        "model": NAME,
        "steps": 24,
        "batch_size": 4,
        "val_every": 8,
        "warmup_steps": 4,
        "learning_rate": 1e-2,
        **options,
    }
    return TrainingConfig(data=data, out=out, **given)


ABOUT = WeightsMetadata(
    model=NAME,
    options={"width": 12, "dropout": 0.25},
    data={"benchmark": "v1", "digest": "d"},
    command="lemma train tiny --data d --out o",
    lemma="0.1.0",
)
"""Metadata of the weights of :func:`written`."""


def tiny(seed: int = 0) -> Tiny:
    torch.manual_seed(seed)
    return Tiny(TinyConfig(width=12, dropout=0.25))


def written(folder: Path, about: WeightsMetadata = ABOUT) -> Path:
    """Write weights, and return their file."""
    path = folder / "weights.safetensors"
    write_weights(path, tiny().state_dict(), about)
    return path


def register() -> None:
    """Add both models to the table, once."""
    if NAME not in MODELS:
        MODELS.add(NAME, (Tiny, TinyConfig))
        MODELS.add(f"{NAME}-episodes", (TinyEpisodes, TinyEpisodesConfig))


if __name__ == "__main__":
    # Tests start it like `python -m lemma.policies.training.loop`, to kill it.
    import tyro

    from lemma.policies.training.loop import main

    torch.set_num_threads(1)
    register()
    tyro.cli(main)
