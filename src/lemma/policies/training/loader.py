"""Batches for training, prepared while the model works on the one before.

The input of a step is a function of the seed and of the step's number, so that a run
that was stopped goes on as if it had not been.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import Batch, Frames, Labels
from lemma.policies.training.augmentation import augment
from lemma.policies.training.config import TrainingConfig
from lemma.policies.training.instructions import with_instructions, with_language

AHEAD = 2
"""Batches that are prepared before they are asked for."""


@dataclass(frozen=True)
class Sampler:
    """Which units (frames or episodes) each step draws: every one once per pass.

    Steps of two sources may share a batch; each source has an order of its own.
    """

    units: int
    batch_size: int
    seed: int
    rank: int = 0
    processes: int = 1
    name: str = "order"
    """Name of the source."""

    def step(self, number: int) -> list[int]:
        """Return the units of a step; all processes together draw from one order."""
        return self.between(number * self.batch_size, (number + 1) * self.batch_size)

    def between(self, before: int, after: int) -> list[int]:
        """Return the units of this process in a step.

        Args:
            before: How many each process drew before it.
            after: How many each has drawn when it is done.
        """
        first = before * self.processes + self.rank * (after - before)
        return [self._unit(place) for place in range(first, first + after - before)]

    def passes(self, steps: int) -> float:
        """Return how often so many steps draw every unit."""
        return steps * self.batch_size * self.processes / self.units

    def _unit(self, place: int) -> int:
        turn, rest = divmod(place, self.units)
        return int(_permutation(self.name, self.seed, turn, self.units)[rest])


@lru_cache(maxsize=8)
def _permutation(name: str, seed: int, turn: int, units: int) -> NDArray[np.int64]:
    return stream(name, seed, turn).permutation(units)


@dataclass(frozen=True)
class FrameSource:
    """Recovery states that are mixed in."""

    frames: Frames
    units: Sequence[Sequence[int]]
    """The frames of every unit."""
    order: Sampler
    share: float
    """Share of the units of each batch; over many steps it is met exactly."""

    def drawn(self, steps: int) -> int:
        """Return how many units each process has drawn from here after some steps."""
        # Products such as 10 * 0.3 shall not lie below the whole number that they are.
        return math.floor(steps * self.order.batch_size * self.share + 1e-6)


class BatchLoader:
    """Makes the batch of any step."""

    def __init__(
        self,
        frames: Frames,
        units: Sequence[Sequence[int]],
        order: Sampler,
        config: TrainingConfig,
        device: torch.device,
        recovery: FrameSource | None = None,
    ) -> None:
        """Prepare nothing yet.

        Args:
            frames: All keyframes of the split.
            units: The frames of every unit.
            order: Which units a step draws.
            config: Options of the training run.
            device: Where batches shall be.
            recovery: Recovery states to mix in, if any.
        """
        self._recovery, self._episodes = recovery, len(frames.episodes)
        self._frames, self._units, self._order = frames, units, order
        self._config, self._device = config, device

    def make(self, step: int) -> Batch:
        """Return the batch of a step."""
        config, order = self._config, self._order
        batch = self._drawn(step)
        rng = stream("batch", config.seed, step, order.rank)
        batch = augment(batch, config.augmentation, rng)
        draw = step if config.augmentation.templates else 0
        batch = with_instructions(
            batch, config.seed, draw, config.kinds, config.augmentation.paraphrases
        )
        return with_language(batch, config.language, rng)

    def _drawn(self, step: int) -> Batch:
        """Return the frames of a step as they are stored."""
        order, recovery = self._order, self._recovery
        before, after = step * order.batch_size, (step + 1) * order.batch_size
        found = []
        if recovery is not None:
            first, last = recovery.drawn(step), recovery.drawn(step + 1)
            before, after = before - first, after - last
            if last > first:
                units = recovery.order.between(first, last)
                rows = [i for unit in units for i in recovery.units[unit]]
                found.append(recovery.frames.batch(rows, self._device))
        if after > before:
            rows = [
                i for unit in order.between(before, after) for i in self._units[unit]
            ]
            found.append(self._frames.batch(rows, self._device))
        if len(found) == 1:
            return found[0]
        mixed_in, usual = found
        return joined(usual, mixed_in, self._episodes)

    @contextmanager
    def ahead(self, first: int, last: int) -> Iterator[Iterator[Batch]]:
        """Prepare the batches of some steps in another thread.

        Args:
            first: Step of the first batch.
            last: Step behind the last.

        Yields:
            The batches, in order; what goes wrong is raised where they are taken.
        """
        queue: Queue[Any] = Queue(AHEAD)
        stop = Event()
        thread = Thread(target=self._fill, args=(queue, stop, first, last), daemon=True)
        thread.start()
        try:
            yield self._taken(queue)
        finally:
            stop.set()
            _drain(queue)
            thread.join()

    def _taken(self, queue: "Queue[Any]") -> Iterator[Batch]:
        while (found := queue.get()) is not None:
            if isinstance(found, BaseException):
                raise found
            batch, ready = found
            if ready is not None:
                now = torch.cuda.current_stream(self._device)
                now.wait_event(ready)
                for tensor in _tensors(batch):
                    # Otherwise its memory would be reused while it is in use here.
                    tensor.record_stream(now)
            yield batch

    def _fill(self, queue: "Queue[Any]", stop: Event, first: int, last: int) -> None:
        try:
            if self._device.type == "cuda":
                self._fill_on_gpu(queue, stop, first, last)
            else:
                for step in range(first, last):
                    if not _put(queue, stop, (self.make(step), None)):
                        return
            _put(queue, stop, None)
        except BaseException as error:
            _put(queue, stop, error)

    def _fill_on_gpu(
        self, queue: "Queue[Any]", stop: Event, first: int, last: int
    ) -> None:
        torch.cuda.set_device(self._device)
        own = torch.cuda.Stream(self._device)  # type: ignore[no-untyped-call]
        # The frames may just have been copied there.
        own.wait_stream(torch.cuda.default_stream(self._device))
        with torch.cuda.stream(own):
            for step in range(first, last):
                batch = self.make(step)
                ready = torch.cuda.Event()  # type: ignore[no-untyped-call]
                ready.record(own)
                if not _put(queue, stop, (batch, ready)):
                    return


def _tensors(batch: Batch) -> list[Tensor]:
    parts: list[Any] = [batch] if batch.labels is None else [batch, batch.labels]
    values = [getattr(part, f.name) for part in parts for f in fields(part)]
    return [value for value in values if isinstance(value, Tensor)]


def _put(queue: "Queue[Any]", stop: Event, item: Any) -> bool:
    """Wait for a place in the queue; return whether anybody still wants it."""
    while not stop.is_set():
        try:
            queue.put(item, timeout=0.2)
        except Full:
            continue
        return True
    return False


def _drain(queue: "Queue[Any]") -> None:
    while True:
        try:
            queue.get_nowait()
        except Empty:
            return


def joined(first: Batch, second: Batch, episodes: int) -> Batch:
    """Return the frames of two labelled batches, of different data, as one.

    Args:
        first: With labels, on the same device and with the same raster as the second.
        second: With labels.
        episodes: How many the first one's data have: those of the second are numbered
            behind them.
    """
    assert first.labels is not None
    assert second.labels is not None
    theirs = replace(second.labels, episode=second.labels.episode + episodes)
    labels = Labels(**_both(first.labels, theirs))
    rest = _both(first, second)
    same = {"raster": first.raster, "entities": first.entities}
    return Batch(**{**rest, **same, "labels": labels})


def _both(one: Any, other: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for field in fields(one):
        pair = getattr(one, field.name), getattr(other, field.name)
        if isinstance(pair[0], Tensor):
            found[field.name] = torch.cat(pair)
        elif isinstance(pair[0], list):
            found[field.name] = [*pair[0], *pair[1]]
    return found
