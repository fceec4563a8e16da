"""Messages of a training run, on the terminal and in logs."""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from importlib import import_module
from typing import Any, Self

import torch
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)
from torch.utils.tensorboard import SummaryWriter

from lemma.core.errors import InvalidConfigError
from lemma.policies.training.config import TrainingConfig

LINE_EVERY_S = 10.0
"""Interval of lines without a terminal for the progress bar."""


class Reporter(ExitStack):
    """Shows progress and writes logs; silent in all processes but the first."""

    def __init__(self, config: TrainingConfig, step: int, *, speaks: bool) -> None:
        """Prepare the reporter.

        Args:
            config: Options of the run, resolved.
            step: First step of this run.
            speaks: Whether this process reports.
        """
        super().__init__()
        self._config, self._first_step, self.speaks = config, step, speaks
        self._console = Console(stderr=True, highlight=False)
        self._said_s = -LINE_EVERY_S
        self._bar: Progress | None = None

    def __enter__(self) -> Self:
        """Open the logs."""
        if not self.speaks:
            return self
        config = self._config
        self._log = SummaryWriter(
            str(config.out / "tensorboard"), purge_step=self._first_step
        )
        self.callback(self._log.close)
        self._tracker = _wandb(config) if config.track else None
        if self._tracker is not None:
            self.callback(self._tracker.finish)
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn(config.model),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[words]}"),
                TimeRemainingColumn(),
                console=self._console,
            )
            self.enter_context(self._bar)
            self._task = self._bar.add_task(
                "", total=config.steps, completed=self._first_step, words=""
            )
        return self

    def step(self, step: int, values: Mapping[str, float]) -> None:
        """Report the progress of training.

        Args:
            step: Number of completed steps.
            values: ``loss``, ``samples_per_s`` and others.
        """
        if not self.speaks:
            return
        self._write(step, {f"train/{name}": v for name, v in values.items()})
        words = f"loss {values['loss']:.4f}  {values['samples_per_s']:.0f} samples/s"
        if memory_gb := gpu_memory_gb():
            words += f"  {memory_gb:.1f} GB"
        if self._bar is not None:
            self._bar.update(self._task, completed=step, words=words)
        elif time.monotonic() - self._said_s >= LINE_EVERY_S:
            self._said_s = time.monotonic()
            self._console.print(
                f"{self._config.model} {step}/{self._config.steps}  {words}",
                soft_wrap=True,
            )

    def scores(self, step: int, scores: Mapping[str, float], *, best: bool) -> None:
        """Report the scores of a validation."""
        if not self.speaks:
            return
        self._write(step, {f"val/{name}": value for name, value in scores.items()})
        text = "  ".join(f"{name} {value:.4f}" for name, value in scores.items())
        self.say(f"step {step}: {text}{'  (best)' if best else ''}")

    def say(self, text: str) -> None:
        """Print a line above the progress bar."""
        if self.speaks:
            console = self._bar.console if self._bar is not None else self._console
            console.print(text, markup=False, soft_wrap=True)

    def _write(self, step: int, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self._log.add_scalar(name, value, step)
        if self._tracker is not None:
            self._tracker.log(dict(values), step=step)


def gpu_memory_gb() -> float:
    """Return the peak GPU memory so far [GB]; 0 on a CPU."""
    if not torch.cuda.is_initialized():  # type: ignore[no-untyped-call]
        return 0.0
    return float(torch.cuda.max_memory_reserved()) / 1e9


def _wandb(config: TrainingConfig) -> Any:
    try:
        wandb = import_module("wandb")
    except ImportError as error:
        raise InvalidConfigError(
            "--track needs wandb, which is not installed. Install it with: python -m "
            "pip install 'lemma-bench[track]'"
        ) from error
    return wandb.init(
        project="lemma",
        name=config.out.name,
        dir=str(config.out),
        config=config.to_dict(),
        resume="allow",
        # The id depends on the folder alone, so a continued run has the same one.
        id=str(config.out.resolve()).replace("/", "-").strip("-")[-64:],
    )
