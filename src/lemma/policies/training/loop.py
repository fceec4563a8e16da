"""The training loop of all models.

``lemma train`` runs it. On several GPUs, start it with ``torchrun --nproc-per-node 8 -m
lemma.policies.training.loop`` and the same arguments.

A run continues from its last checkpoint with the same result as an uninterrupted run,
because all random numbers are functions of the seed and the step.
"""

import math
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, Literal

import torch
import tyro
from torch import Tensor

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.files import only_writer, write_json
from lemma.core.version import VERSION as __version__
from lemma.policies.models.catalog import options_of
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.distributed import ProcessGroup, processes
from lemma.policies.training.loader import BatchLoader, FrameSource, Sampler
from lemma.policies.training.logging import Reporter, gpu_memory_gb
from lemma.policies.training.run import (
    CHECKPOINT,
    REPORT,
    WEIGHTS,
    Data,
    TrainingReport,
    clear_run,
    first_model,
    open_run,
    read_frames,
    recovery_units,
    training_units,
)
from lemma.policies.training.step import (
    Scores,
    Trainer,
    read_state,
    validate,
    write_state,
)
from lemma.policies.weights_file import (
    TIME_LIMIT,
    WeightsMetadata,
    load_weights,
    mark_ended,
    write_weights,
)

LOG_EVERY = 20
"""Steps between readings of the losses, each of which waits for the GPU."""


class TrainingError(LemmaError, RuntimeError):
    """A training run that cannot go on."""


@dataclass
class _Progress:
    """Contents of a checkpoint besides the weights."""

    elapsed_s: float = 0.0
    samples: int = 0
    best_step: int = -1
    scores: Scores = field(default_factory=dict)
    history: list[dict[str, float]] = field(default_factory=list)


def train(
    config: TrainingConfig, *, restart: bool = False, command: str | None = None
) -> TrainingReport:
    """Train a model, or continue an unfinished run.

    Args:
        config: Options of the training run.
        restart: Whether to begin anew, even if the folder has a run.
        command: The command line; if None, that of this process, ``lemma``.

    Returns:
        The report. The best weights are ``weights.safetensors`` in the run's folder.

    Raises:
        DatasetError: The data are missing, damaged or of another version; or another
            run is in the folder.
        UnknownNameError: There is no such model, option, split or task.
        InvalidConfigError: An option is invalid.
        WeightsError: The checkpoint is damaged.
        TrainingError: The GPU's memory is too small, or training diverged.
    """
    command = command or shlex.join(["lemma", *sys.argv[1:]])
    with processes(config.device) as team:
        config = config.resolved(team.count)
        held = only_writer(config.out) if team.first else nullcontext()
        with held, _explained(config):
            if team.device.type == "cuda":
                torch.set_float32_matmul_precision("high")
            if restart and team.first:
                clear_run(config.out)
            team.agree(0.0)
            return _Run(config, team, command).go()


class _Run:
    def __init__(
        self, config: TrainingConfig, team: ProcessGroup, command: str
    ) -> None:
        self.config, self.team, self.command = config, team, command
        self.model = first_model(config)
        if config.augmentation.relational and not self.model.reads_places:
            raise InvalidConfigError(
                f"{config.model} does not read sentences with the scene, so it cannot "
                "learn from relational ones. Leave out --augmentation.relational."
            )
        # The benchmark tries all kernels for every new shape, which takes seconds.
        torch.backends.cudnn.benchmark = self.model.of_fixed_shape
        self.data: Data = read_frames(
            config, team, self.model.entities, mixed=self.model.of_any_team
        )
        if team.first:
            open_run(config, self.model, self.data.about, command)
        self.trainer = Trainer(self.model, config, team)
        self.units = training_units(self.model, self.data.train, config)
        draws = config.batch_size or 1, config.seed, team.rank, team.count
        self.order = Sampler(len(self.units), *draws)
        self.so_far = _Progress()
        self.steps = config.steps or 0
        self._losses: list[dict[str, Tensor]] = []
        self._busy_s, self._waited_s, self._here = 0.0, 0.0, 0
        if (config.out / CHECKPOINT).exists():
            state = read_state(config.out / CHECKPOINT, team.device)
            self.trainer.restore(state["trainer"])
            self.so_far = _Progress(**state["so_far"])

    def _mixed_in(self) -> FrameSource | None:
        """Return the recovery states, if there are any."""
        frames, share = self.data.recovery, self.config.recovery_share
        if frames is None or share is None:
            return None
        units = recovery_units(self.model, frames, self.units, self.data.train)
        order = replace(self.order, units=len(units), name="recovery")
        return FrameSource(frames, units, order, share)

    def go(self) -> TrainingReport:
        """Train to the end, or until a signal stops the run."""
        config, trainer, source = self.config, self.trainer, self.data.train
        how = (
            self.order,
            config,
            self.team.device,
            self._mixed_in(),
            trainer.model,
        )
        feed = BatchLoader(source, self.units, *how)
        first = trainer.step
        begun = self.so_far.elapsed_s
        start = saved = self._logged = time.perf_counter()
        with (
            Reporter(config, first, speaks=self.team.first) as self.reporter,
            _stop_signals() as stop,
            feed.ahead(first, self.steps) as batches,
        ):
            if first:
                self.reporter.say(f"Going on from step {first} of {self.steps}.")
            while True:
                now = time.perf_counter()
                self.so_far.elapsed_s = begun + now - start
                is_due = now - saved > config.checkpoint_every_s
                done, stopped, due = self.team.agree(
                    self._done(), stop.is_set(), is_due
                )
                if stopped or due:
                    self._save()
                    saved = now
                if done >= 1.0 or stopped:
                    break
                asked = time.perf_counter()
                batch = next(batches)
                self._waited_s += time.perf_counter() - asked
                self._losses.append(trainer.train(batch, done))
                self.so_far.samples += len(batch) * self.team.count
                self._here += len(batch) * self.team.count
                if trainer.step % LOG_EVERY == 0:
                    self._log()
                if trainer.step % (config.val_every or 1) == 0:
                    self._validate()
            if not stopped:
                self._end()
            return self._report(bool(stopped))

    def _done(self) -> float:
        """Return the completed share of the training, 0 to 1."""
        limit = self.config.time_limit_s or math.inf
        return max(self.trainer.step / self.steps, self.so_far.elapsed_s / limit)

    def _log(self) -> None:
        """Read and report the losses since the last call."""
        if not self._losses:
            return
        names = list(self._losses[-1])
        rows = torch.stack([torch.stack([t[n] for n in names]) for t in self._losses])
        means = dict(zip(names, rows.float().mean(0).tolist(), strict=True))
        now = time.perf_counter()
        self._busy_s += now - self._logged
        self._logged = now
        steps, self._losses = len(self._losses), []
        if not math.isfinite(means["loss"] + means["gradient"]):
            raise TrainingError(
                f"The loss became infinite within {steps} steps of step "
                f"{self.trainer.step}. The last checkpoint is from before; lower "
                "--learning-rate or --clip, with another --out."
            )
        rate = self.trainer.optimizer.param_groups[0]["lr"]
        speed = self._here / max(self._busy_s, 1e-9)
        self.reporter.step(
            self.trainer.step,
            {**means, "learning_rate": rate, "samples_per_s": speed},
        )

    def _validate(self) -> None:
        """Score the averaged weights, and save them if they are the best."""
        self._log()
        model, step, so_far = self.trainer.average, self.trainer.step, self.so_far
        scores = validate(model, self.data.val, self.config, self.team)
        chosen = scores.get(model.selection, math.nan)
        best = so_far.scores.get(model.selection, -math.inf)
        better = so_far.best_step < 0 or chosen > best
        so_far.history.append({"step": step, **scores})
        if better:
            so_far.best_step, so_far.scores = step, scores
            if self.team.first:
                metadata = WeightsMetadata(
                    model=self.config.model,
                    options=options_of(self.model),
                    data=self.data.about,
                    command=self.command,
                    scores=dict(scores),
                    training=self.config.to_dict(),
                    lemma=__version__,
                )
                path = self.config.out / WEIGHTS
                write_weights(path, model.state_dict(), metadata)
        self.reporter.scores(step, scores, best=better)
        self._logged = time.perf_counter()

    def _save(self) -> None:
        self._log()
        if self.team.first:
            state = {"trainer": self.trainer.state(), "so_far": asdict(self.so_far)}
            write_state(self.config.out / CHECKPOINT, state)
        self._logged = time.perf_counter()

    def _end(self) -> None:
        """Score the last weights, and save the checkpoint."""
        history = self.so_far.history
        if not history or history[-1]["step"] != self.trainer.step:
            self._validate()
        self._save()
        if self.team.first:
            finished = self.trainer.step >= self.steps
            ended: Literal["steps", "time limit"]
            ended = "steps" if finished else TIME_LIMIT
            mark_ended(self.config.out / WEIGHTS, ended, self.trainer.step)

    def _report(self, stopped: bool) -> TrainingReport:
        self._log()
        finished = self.trainer.step >= self.steps
        status = "finished" if finished else "time is up"
        frames = sum(map(len, self.units))
        share = self.config.recovery_share or 0.0
        device = "CPU"
        if self.team.device.type == "cuda":
            device = str(torch.cuda.get_device_name(self.team.device))
        report = TrainingReport(
            status="interrupted" if stopped else status,
            model=self.config.model,
            parameters=sum(
                p.numel() for p in self.model.parameters() if p.requires_grad
            ),
            steps=self.trainer.step,
            samples=self.so_far.samples,
            passes=self.so_far.samples * (1 - share) / frames,
            seconds=self.so_far.elapsed_s,
            samples_per_s=self._here / self._busy_s if self._busy_s else 0.0,
            input_wait=self._waited_s / self._busy_s if self._busy_s else 0.0,
            gpu_memory_gb=gpu_memory_gb(),
            device=device,
            scores=self.so_far.scores,
            best_step=self.so_far.best_step,
            scores_by_kind={} if stopped else self._scores_by_kind(),
            history=self.so_far.history,
            data=self.data.about,
            command=self.command,
            lemma=__version__,
            torch=torch.__version__,
        )
        if self.team.first:
            write_json(self.config.out / REPORT, asdict(report))
        return report

    def _scores_by_kind(self) -> dict[str, Scores]:
        self.team.agree(0.0)
        best = load_weights(self.config.out / WEIGHTS, self.team.device)
        return {
            kind: validate(best, self.data.val, self.config, self.team, (kind,))
            for kind in self.config.kinds
        }


@contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl-C or SIGTERM sets.

    The second Ctrl-C ends the process at once.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def ask(number: int, _: Any) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    before = {n: signal.signal(n, ask) for n in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _explained(config: TrainingConfig) -> Iterator[None]:
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        raise TrainingError(
            f"The GPU's memory is too small for batches of {config.batch_size}: "
            f"{str(error).splitlines()[0]} Try --batch-size "
            f"{max(1, (config.batch_size or 2) // 2)}, or --images host, with another "
            "--out."
        ) from error


def main(
    config: Annotated[TrainingConfig, tyro.conf.arg(name="")], restart: bool = False
) -> None:
    """Train a model with all processes that torchrun starts.

    Args:
        config: Options of the training run.
        restart: Begin anew, even if the folder has a run.
    """
    words = shlex.join(sys.argv[1:])
    count = os.environ.get("WORLD_SIZE", "1")
    command = (
        f"torchrun --nproc-per-node {count} -m lemma.policies.training.loop {words}"
    )
    try:
        train(config, restart=restart, command=command)
    except LemmaError as error:
        sys.stderr.write(f"{error}\n")
        raise SystemExit(2) from error


if __name__ == "__main__":
    tyro.cli(main)
