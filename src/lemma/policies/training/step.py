"""One training step, the state between steps, and validation."""

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from lemma.core.errors import InvalidConfigError, WeightsError
from lemma.core.files import write_whole
from lemma.core.seeding import stream
from lemma.policies.batch import Batch, moved
from lemma.policies.frames import Frames
from lemma.policies.layers import Network
from lemma.policies.models.base import Model
from lemma.policies.text.instructions import (
    with_instructions,
    with_language,
    with_places,
)
from lemma.policies.training.captured import CapturedStep
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.distributed import ProcessGroup

Scores = dict[str, float]
"""Mean scores by name, without scores that no frame has."""


class _Losses(nn.Module):
    """A model's losses as a forward pass, for distributed data parallelism."""

    def __init__(self, model: Model) -> None:
        super().__init__()
        self.model = model

    def forward(self, batch: Batch) -> dict[str, Tensor]:
        return self.model.loss(batch)


class Trainer:
    """A model, the moving average of its weights, and its optimizer."""

    def __init__(
        self, model: Model, config: TrainingConfig, team: ProcessGroup
    ) -> None:
        """Prepare step 0.

        Args:
            model: Model with its initial weights.
            config: Resolved options.
            team: The process group.
        """
        self.config, self.team, self.step = config, team, 0
        layout = torch.channels_last if config.channels_last else torch.preserve_format
        self.model = model.to(team.device, memory_format=layout).train()  # type: ignore[call-overload]
        self.average: Model = deepcopy(self.model).eval().requires_grad_(False)
        self.optimizer = torch.optim.AdamW(
            _groups(self.model, config.weight_decay),
            lr=config.learning_rate or 0.0,
            betas=(0.9, 0.98),
            fused=team.device.type == "cuda",
        )
        new = self.model.state_dict()
        pairs = [(old, new[name]) for name, old in self.average.state_dict().items()]
        floats = [pair for pair in pairs if pair[0].is_floating_point()]
        self._averages = [old for old, _ in floats]
        self._values = [value for _, value in floats]
        self._counts = [pair for pair in pairs if not pair[0].is_floating_point()]
        if config.compile and team.device.type == "cuda":
            # For fixed shapes, dynamic kernels take longer to compile and are slower.
            compile_parts(self.model, False if self.model.of_fixed_shape else None)
        losses: Any = _Losses(self.model)
        if team.count > 1:
            losses = DistributedDataParallel(losses)
        self._losses = losses
        self._captured: CapturedStep | None = None
        self._captures = (
            config.capture
            and self.model.of_fixed_shape
            and team.device.type == "cuda"
            and team.count == 1
        )

    def train(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        """Run one step.

        Args:
            batch: Batch with labels.
            progress: Completed share of the training, 0 to 1.

        Returns:
            The terms of the loss, their sum ``loss``, and ``gradient``, the norm of the
            gradient before clipping; on the device, without synchronisation.
        """
        config = self.config
        # Dropout uses torch's global random state. A seed for each step makes it a
        # function of the step, so that a checkpoint needs no random state.
        torch.manual_seed(seed_of(config.seed, self.step, self.team.rank))
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(config, self.step, progress)
        terms = self._captured_gradients(batch) if self._captures else None
        if terms is None:
            self.optimizer.zero_grad(set_to_none=True)
            terms = self._gradients(batch)
        norm = nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        self.optimizer.step()
        self.step += 1
        self._average()
        return {**terms, "gradient": norm.detach()}

    def _gradients(self, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of a batch, and set the gradients of the weights."""
        with autocast(self.config, self.team.device):
            terms: dict[str, Tensor] = self._losses(batch)
        loss = torch.stack([term.float() for term in terms.values()]).sum()
        loss.backward()  # type: ignore[no-untyped-call]
        detached = {name: term.detach() for name, term in terms.items()}
        return {**detached, "loss": loss.detach()}

    def _captured_gradients(self, batch: Batch) -> dict[str, Tensor] | None:
        """Run :meth:`_gradients` as a captured step; None if the batch does not fit."""
        if self._captured is None:

            def compute(static: Batch) -> dict[str, Tensor]:
                self.optimizer.zero_grad(set_to_none=True)
                return self._gradients(static)

            self._captured = CapturedStep(compute, batch)
        return self._captured(batch) if self._captured.fits(batch) else None

    @torch.no_grad()
    def _average(self) -> None:
        # A faster decay at first, so that the initial weights vanish from the average.
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        torch._foreach_lerp_(self._averages, self._values, 1.0 - decay)
        for old, new in self._counts:
            old.copy_(new)

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, without random states."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state from :meth:`state`."""
        self.step = state["step"]
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])


def compile_parts(module: nn.Module, dynamic: bool | None = None) -> None:
    """Compile the :class:`~lemma.policies.layers.Network` parts of a model.

    The compiler treats sentences and numbers of entities as constants, so it would
    compile a whole model anew for every batch.

    Args:
        module: The model.
        dynamic: Whether to compile for all shapes; if None, from the second shape on.
    """
    for part in module.children():
        if isinstance(part, Network):
            part.compile(dynamic=dynamic)
        else:
            compile_parts(part, dynamic)


def learning_rate(config: TrainingConfig, step: int, progress: float) -> float:
    """Return the learning rate of a step: linear warm-up, then a cosine to zero.

    Args:
        config: Resolved options.
        step: Number of completed steps.
        progress: Completed share of the training, 0 to 1.
    """
    warm = min(1.0, (step + 1) / max(1, config.warmup_steps))
    cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))
    return (config.learning_rate or 0.0) * warm * cosine


def seed_of(seed: int, step: int, rank: int = 0) -> int:
    """Return the seed of torch's random numbers in a step."""
    return int(stream("torch", seed, step, rank).integers(2**62))


def _groups(model: Model, weight_decay: float) -> list[dict[str, Any]]:
    """Return parameter groups, with weight decay for matrices and kernels only."""
    trained = [value for value in model.parameters() if value.requires_grad]
    matrices = [value for value in trained if value.ndim > 1]
    others = [value for value in trained if value.ndim <= 1]
    return [
        {"params": matrices, "weight_decay": weight_decay},
        {"params": others, "weight_decay": 0.0},
    ]


def write_state(path: Path, state: dict[str, Any]) -> None:
    """Write the state of a training run, atomically.

    Args:
        path: The file.
        state: Tensors, numbers, texts, lists and dictionaries.

    Raises:
        DatasetError: The disk is full, or the folder cannot be written to.
    """
    write_whole(path, lambda draft: torch.save(state, draft))


def read_state(path: Path, device: torch.device) -> dict[str, Any]:
    """Return the state of a training run; nothing in it is executed.

    Raises:
        WeightsError: The file is damaged.
    """
    try:
        state: dict[str, Any] = torch.load(path, device, weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, UnpicklingError) as error:
        raise WeightsError(
            f"{path} is damaged: {error}. Use --restart to begin this run anew; the "
            "best weights so far, weights.safetensors, are replaced then."
        ) from error
    return state


def validate(
    model: Model,
    frames: Frames,
    config: TrainingConfig,
    team: ProcessGroup,
    kinds: Sequence[str] = (),
) -> Scores:
    """Return the mean scores of a model over all frames of a split.

    Args:
        model: Model in evaluation mode.
        frames: Frames of the split.
        config: Options of the training run: batch size, kinds of instructions, control.
        team: The process group, which shares the batches.
        kinds: Kinds of instructions; those of the training run if empty.
    """
    units = units_of(model, frames.episodes)
    batch_size = config.batch_size or 1
    sums: dict[str, Tensor] = {}
    starts = range(0, len(units), batch_size)
    for start in starts[team.rank :: team.count]:
        rows = [i for unit in units[start : start + batch_size] for i in unit]
        batch = frames.batch(rows, team.device)
        batch = with_instructions(batch, 0, 0, kinds or config.kinds)
        if places := config.augmentation.relational:
            batch = with_places(batch, places, stream("places", start))
        batch = with_language(batch, config.language, stream("control", start))
        batch = moved(batch, team.device)
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


def units_of(model: Model, episodes: Sequence[Sequence[int]]) -> list[Sequence[int]]:
    """Return the frames of each training unit of a model."""
    if model.unit == "episode":
        return list(episodes)
    return [(frame,) for episode in episodes for frame in episode]


def autocast(config: TrainingConfig, device: torch.device) -> torch.autocast:
    """Return the context in which a network runs."""
    return torch.autocast(
        device.type,
        dtype=torch.bfloat16,
        enabled=config.precision == "bf16" and device.type == "cuda",
    )
