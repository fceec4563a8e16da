"""Train your own small model, which predicts the robot of the next sub-task.

python examples/03_data.py
python examples/04_train_a_model.py [FOLDER] [STEPS]

Needs torch: pip install "lemma-bench[learn]". The loop, checkpoints, validation and
files are those of ``lemma train``, which trains the published models.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.policies.batch import Batch
from lemma.policies.models.base import MODELS, Model
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.loop import train
from lemma.policies.weights import load_model


@dataclass(frozen=True)
class WhoIsNextConfig:
    """Options of the model, which are in its file of weights."""

    width: int = 16


class WhoIsNext(Model):
    """Predicts the next robot from the top-down map and the last robot.

    It does not read the instruction, which is in ``batch.instructions``.
    """

    selection = "robot"

    def __init__(self, config: WhoIsNextConfig) -> None:
        """Make the layers."""
        super().__init__()
        self.config = config
        self.encoder = nn.Sequential(
            *(nn.Conv2d(4, config.width, 5, stride=2, padding=2), nn.ReLU()),
            *(nn.Conv2d(config.width, config.width, 5, stride=2, padding=2), nn.ReLU()),
            *(nn.AdaptiveMaxPool2d(4), nn.Flatten()),
        )
        self.choice = nn.LazyLinear(2)
        self.choice(torch.zeros(1, 16 * config.width + 2))

    def forward(self, batch: Batch) -> Tensor:
        """Return a score for each robot, (B, 2)."""
        colors = batch.rgb.permute(0, 3, 1, 2).float() / 255.0
        map_ = torch.cat([colors, batch.height_m[:, None] / 0.1], 1)
        seen = self.encoder(F.avg_pool2d(map_, 8))
        acted = [(batch.past[:, :, 0] == robot).sum(1) for robot in (0, 1)]
        scores: Tensor = self.choice(torch.cat([seen, torch.stack(acted, 1)], 1))
        return scores

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the loss, without frames of ``stop``, which has no robot."""
        assert batch.labels is not None
        wanted = batch.labels.decision[:, 0]
        return {"robot": F.cross_entropy(self(batch).float(), wanted, ignore_index=-1)}

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return the probability of the expert's choice, (B,); NaN for ``stop``."""
        assert batch.labels is not None
        wanted = batch.labels.decision[:, :1]
        right = self(batch).float().softmax(-1).gather(1, wanted.clamp(min=0))[:, 0]
        return {"robot": right.masked_fill(wanted[:, 0] < 0, torch.nan)}


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/first-data")
    steps = int(sys.argv[2]) if len(sys.argv) > 2 else 100

    MODELS.add("who-is-next", (WhoIsNext, WhoIsNextConfig))
    config = TrainingConfig(
        "who-is-next",
        data=folder / "keyframes",
        out=folder / "who-is-next",
        options=("width=8",),
        steps=steps,
        batch_size=8,
        warmup_steps=10,
        learning_rate=1e-2,
        device="cpu",
    )
    report = train(config)
    model = load_model(str(config.out))
    print(type(model).__name__, f"of step {report.best_step}:", report.scores)
