"""Batches for training, prepared in other threads.

The input of a step is a function of the seed and of the step's number, so a continued
run equals an uninterrupted one. Instructions are newly drawn for each batch, or
replaced in control experiments.
"""

import math
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, repeat
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import Batch, moved
from lemma.policies.frames import Frames
from lemma.policies.models.base import Model
from lemma.policies.text.instructions import (
    with_instructions,
    with_language,
    with_places,
)
from lemma.policies.text.lessons import Lesson
from lemma.policies.training.augmentation import augment
from lemma.policies.training.config import TrainingConfig

AHEAD = 5
"""Number of batches to prepare ahead."""
PROCESSES = 2
"""Processes that draw lessons for a GPU."""
THREADS = 3
"""Threads that prepare them: some copy images while another makes sentences."""

Made = Future[tuple[Batch, Any]]


@dataclass(frozen=True)
class Sampler:
    """Draws the units (frames or episodes) of each step, each once per epoch.

    A batch may have units of two sources; each source has its own order.
    """

    units: int
    batch_size: int
    seed: int
    rank: int = 0
    processes: int = 1
    name: str = "order"
    """Name of the source."""

    def step(self, number: int) -> list[int]:
        """Return the units of a step; all processes share one order."""
        return self.between(number * self.batch_size, (number + 1) * self.batch_size)

    def between(self, before: int, after: int) -> list[int]:
        """Return the units of this process in a step.

        Args:
            before: Units per process before the step.
            after: Units per process after the step.
        """
        first = before * self.processes + self.rank * (after - before)
        return [self._unit(place) for place in range(first, first + after - before)]

    def _unit(self, place: int) -> int:
        turn, rest = divmod(place, self.units)
        return int(_permutation(self.name, self.seed, turn, self.units)[rest])


@lru_cache(maxsize=8)
def _permutation(name: str, seed: int, turn: int, units: int) -> NDArray[np.int64]:
    return stream(name, seed, turn).permutation(units)


@dataclass(frozen=True)
class FrameSource:
    """Recovery states that are mixed into batches."""

    frames: Frames
    units: Sequence[Sequence[int]]
    """The frames of every unit."""
    order: Sampler
    share: float
    """Share of the units of each batch, exact over many steps."""

    def drawn(self, steps: int) -> int:
        """Return the number of units per process from this source after some steps."""
        # The small addend avoids rounding down of products such as 10 * 0.3.
        return math.floor(steps * self.order.batch_size * self.share + 1e-6)


class BatchLoader:
    """Creates the batch of any step."""

    def __init__(
        self,
        frames: Frames,
        units: Sequence[Sequence[int]],
        order: Sampler,
        config: TrainingConfig,
        device: torch.device,
        recovery: FrameSource | None = None,
        model: Model | None = None,
    ) -> None:
        """Store the sources.

        Args:
            frames: All keyframes of the split.
            units: The frames of every unit.
            order: Draws the units of a step.
            config: Options of the training run.
            device: Device of the batches.
            recovery: Recovery states to mix in, if any.
            model: Model that converts texts and names to tensors, if any does.
        """
        self._model = model
        self._lessons = model.lessons(order.batch_size) if model else None
        self._recovery, self._episodes = recovery, len(frames.episodes)
        self._frames, self._units, self._order = frames, units, order
        self._config, self._device = config, device

    def make(self, step: int, lesson: Lesson | None = None) -> Batch:
        """Return the batch of a step.

        Args:
            step: Number of the step.
            lesson: The step's lesson, if the model has any; drawn here if None.
        """
        config = self._config
        batch = self._drawn(step)
        rng = stream("batch", config.seed, step, self._order.rank)
        batch = augment(batch, config.augmentation, rng)
        draw = step if config.augmentation.templates else 0
        batch = with_instructions(
            batch, config.seed, draw, config.kinds, config.augmentation.paraphrases
        )
        if config.augmentation.relational:
            batch = with_places(batch, config.augmentation.relational, rng)
        batch = with_language(batch, config.language, rng)
        if self._lessons is not None:
            drawn = lesson or self._lessons.draw(config.seed, step, self._order.rank)
            batch = replace(batch, lesson=drawn)
        tensors = self._model.text_tensors(batch) if self._model else {}
        return moved(replace(batch, text_tensors=tensors), self._device)

    def _drawn(self, step: int) -> Batch:
        """Return the frames of a step without augmentation."""
        size, recovery = self._order.batch_size, self._recovery
        first = last = 0
        if recovery is not None:
            first, last = recovery.drawn(step), recovery.drawn(step + 1)
        drawn = self._order.between(step * size - first, (step + 1) * size - last)
        rows = [i for unit in drawn for i in self._units[unit]]
        usual = self._frames.batch(rows, self._device) if rows else None
        if recovery is None or last == first:
            assert usual is not None
            return usual
        drawn = recovery.order.between(first, last)
        rows = [i for unit in drawn for i in recovery.units[unit]]
        mixed_in = recovery.frames.batch(rows, self._device)
        return joined(usual, mixed_in, self._episodes) if usual else mixed_in

    @contextmanager
    def ahead(self, first: int, last: int) -> Iterator[Iterator[Batch]]:
        """Prepare the batches of some steps in other threads.

        Args:
            first: Step of the first batch.
            last: Step after the last.

        Yields:
            An iterator over the batches, in order; it raises errors of the threads.
        """
        own = None
        if self._device.type == "cuda":
            own = torch.cuda.Stream(self._device)  # type: ignore[no-untyped-call]
            # Frames may still be in a copy to the device.
            own.wait_stream(torch.cuda.default_stream(self._device))
        steps = range(first, last)
        with (
            closing(self._lesson_of_each(steps)) as lessons,
            ThreadPoolExecutor(THREADS) as threads,
        ):
            jobs = (
                threads.submit(self._made, step, lesson, own)
                for step, lesson in zip(steps, lessons, strict=True)
            )
            try:
                yield self._batches(jobs, deque(islice(jobs, AHEAD)))
            finally:
                threads.shutdown(wait=False, cancel_futures=True)

    def _lesson_of_each(self, steps: Sequence[int]) -> Generator[Lesson | None]:
        if self._lessons is None or self._device.type == "cpu":
            yield from repeat(None, len(steps))
        else:
            how = self._config.seed, self._order.rank, PROCESSES
            yield from self._lessons.ahead(steps, *how)

    def _made(self, step: int, lesson: Lesson | None, own: Any) -> tuple[Batch, Any]:
        """Return a batch and, on a GPU, the event after its last operation."""
        if own is None:
            return self.make(step, lesson), None
        torch.cuda.set_device(self._device)
        with torch.cuda.stream(own):
            return self.make(step, lesson), own.record_event()

    def _batches(self, jobs: Iterator[Made], waiting: deque[Made]) -> Iterator[Batch]:
        while waiting:
            batch, ready = waiting.popleft().result()
            waiting.extend(islice(jobs, 1))
            if ready is not None:
                now = torch.cuda.current_stream(self._device)
                now.wait_event(ready)
                for part in (vars(batch), vars(batch.labels), batch.text_tensors):
                    for tensor in part.values():
                        if isinstance(tensor, Tensor):
                            # Keep the allocator from reusing its memory too early.
                            tensor.record_stream(now)
            yield batch


def joined(first: Batch, second: Batch, episodes: int) -> Batch:
    """Concatenate two labelled batches of different data.

    Args:
        first: Batch with labels, on the same device and raster as the second.
        second: Batch with labels.
        episodes: Number of episodes in the first one's data, which is added to the
            numbers of the second one's episodes.
    """
    assert first.labels is not None
    assert second.labels is not None
    theirs = replace(second.labels, episode=second.labels.episode + episodes)
    labels = replace(first.labels, **_both(first.labels, theirs))
    return replace(first, **_both(first, second), labels=labels)


def _both(one: Any, other: Any) -> dict[str, Any]:
    """Concatenate the tensors and lists of two records."""
    found: dict[str, Any] = {}
    for name, value in vars(one).items():
        if isinstance(value, Tensor):
            found[name] = torch.cat([value, getattr(other, name)])
        elif isinstance(value, list):
            found[name] = [*value, *getattr(other, name)]
    return found
