"""What is told of a training run when it is over."""

from dataclasses import dataclass
from typing import Any

from lemma.policies.scoring import Scores


@dataclass(frozen=True)
class Report:
    """How a run went; written as ``report.json``."""

    status: str
    """``finished``, ``time is up`` or ``interrupted``."""
    model: str
    parameters: int
    """Trained ones."""
    steps: int
    samples: int
    """Frames that were trained on."""
    passes: float
    """How often each frame was seen, of demonstrations."""
    seconds: float
    """Of training, in all runs."""
    samples_per_s: float
    """Frames per second in this run, validation and checkpoints left out."""
    input_wait: float
    """Share of that time in which the model waited for its batch, 0 to 1."""
    gpu_memory_gb: float
    """Largest, of this run."""
    device: str
    scores: Scores
    """Of the best weights, in validation."""
    best_step: int
    scores_by_kind: dict[str, Scores]
    """The same, for each kind of instruction alone; when a run is over."""
    history: list[dict[str, float]]
    """All validations."""
    data: dict[str, Any]
    command: str
    lemma: str
    torch: str
