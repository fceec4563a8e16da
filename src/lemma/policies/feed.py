"""Batches for training, prepared while the model works on the one before.

What a step is given is a function of the seed and of the step's number, so that a run
that was stopped goes on as if it had not been.
"""

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
from lemma.policies.augmentation import augment
from lemma.policies.frames import Batch, Frames
from lemma.policies.sentences import with_instructions, with_language
from lemma.policies.training import TrainingConfig

AHEAD = 2
"""Batches that are prepared before they are asked for."""


@dataclass(frozen=True)
class Order:
    """Which units (frames or episodes) each step draws: every one once per pass."""

    units: int
    batch_size: int
    seed: int
    rank: int = 0
    processes: int = 1

    def step(self, number: int) -> list[int]:
        """Return the units of a step; all processes together draw from one order."""
        size = self.batch_size * self.processes
        first = number * size + self.rank * self.batch_size
        return [self._unit(place) for place in range(first, first + self.batch_size)]

    def passes(self, steps: int) -> float:
        """Return how often so many steps draw every unit."""
        return steps * self.batch_size * self.processes / self.units

    def _unit(self, place: int) -> int:
        turn, rest = divmod(place, self.units)
        return int(_permutation(self.seed, turn, self.units)[rest])


@lru_cache(maxsize=4)
def _permutation(seed: int, turn: int, units: int) -> NDArray[np.int64]:
    return stream("order", seed, turn).permutation(units)


class Feed:
    """Makes the batch of any step."""

    def __init__(
        self,
        frames: Frames,
        units: Sequence[Sequence[int]],
        order: Order,
        config: TrainingConfig,
        device: torch.device,
    ) -> None:
        """Prepare nothing yet.

        Args:
            frames: All keyframes of the split.
            units: The frames of every unit.
            order: Which units a step draws.
            config: Of the training run.
            device: Where batches shall be.
        """
        self._frames, self._units, self._order = frames, units, order
        self._config, self._device = config, device

    def make(self, step: int) -> Batch:
        """Return the batch of a step."""
        config, order = self._config, self._order
        rows = [i for unit in order.step(step) for i in self._units[unit]]
        batch = moved(self._frames.batch(rows), self._device)
        rng = stream("batch", config.seed, step, order.rank)
        batch = augment(batch, config.augmentation, rng)
        draw = step if config.augmentation.templates else 0
        batch = with_instructions(
            batch, config.seed, draw, config.kinds, config.augmentation.paraphrases
        )
        return with_language(batch, config.language, rng)

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
                    # Else its memory would be given away while it is in use here.
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


def moved(batch: Batch, device: torch.device) -> Batch:
    """Return a batch whose tensors are on a device."""
    if batch.rgb.device == device or (device.type == "cpu" == batch.rgb.device.type):
        return batch

    def there(part: Any) -> dict[str, Any]:
        return {
            f.name: getattr(part, f.name).pin_memory().to(device, non_blocking=True)
            for f in fields(part)
            if isinstance(getattr(part, f.name), Tensor)
        }

    labels = batch.labels and replace(batch.labels, **there(batch.labels))
    return replace(batch, **there(batch), labels=labels)


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
