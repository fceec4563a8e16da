"""How well a model decides on frames that it was not trained on."""

from collections.abc import Sequence

import torch
from torch import Tensor

from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream
from lemma.policies.batch import Frames
from lemma.policies.models.base import Model
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.distributed import ProcessGroup
from lemma.policies.training.instructions import with_instructions, with_language

Scores = dict[str, float]
"""Mean scores by name, without those for which no frame counts."""


def validate(
    model: Model,
    frames: Frames,
    config: TrainingConfig,
    team: ProcessGroup,
    kinds: Sequence[str] = (),
) -> Scores:
    """Return the mean scores of a model over all frames of a split.

    Args:
        model: In evaluation mode.
        frames: Frames of the split.
        config: Options of the training run: batch size, kinds of sentences, control.
        team: Processes, each of which does a part.
        kinds: Kinds of sentences, if not those of the training run.
    """
    units = units_of(model, frames)
    batch_size = config.batch_size or 1
    sums: dict[str, Tensor] = {}
    starts = range(0, len(units), batch_size)
    for start in starts[team.rank :: team.count]:
        rows = [i for unit in units[start : start + batch_size] for i in unit]
        batch = frames.batch(rows, team.device)
        batch = with_instructions(batch, 0, 0, kinds or config.kinds)
        batch = with_language(batch, config.language, stream("control", start))
        with torch.inference_mode(), autocast(config, team.device):
            scores = model.score(batch)
        for name, values in scores.items():
            exact = values.double()
            both = torch.stack([exact.nansum(), (~exact.isnan()).sum().double()])
            sums[name] = sums[name] + both if name in sums else both
    if team.count > len(starts):
        raise InvalidConfigError(
            f"{team.count} processes cannot share {len(starts)} batches of validation. "
            "Use fewer processes, or a smaller --batch-size."
        )
    totals = {name: team.total(sums[name]) for name in sorted(sums)}
    means = {name: total.tolist() for name, total in totals.items()}
    return {name: sum_ / count for name, (sum_, count) in means.items() if count}


def units_of(model: Model, frames: Frames) -> list[Sequence[int]]:
    """Return the frames of each unit that a model is trained on."""
    if model.unit == "episode":
        return list(frames.episodes)
    return [(i,) for i in range(len(frames))]


def autocast(config: TrainingConfig, device: torch.device) -> torch.autocast:
    """Return the context in which a network runs."""
    return torch.autocast(
        device.type,
        dtype=torch.bfloat16,
        enabled=config.precision == "bf16" and device.type == "cuda",
    )
