"""Sentences for a reader alone, which a training step adds to those of its frames.

They do not depend on the frames, and Python makes them more slowly than a GPU reads
them, so other processes can draw them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lemma.core.seeding import stream
from lemma.core.workers.pool import ProcessPool, run_in_order
from lemma.policies.entities import EntitySet
from lemma.policies.text.encoder import SentenceReader
from lemma.policies.text.orders import draw_order
from lemma.policies.text.refusals import refusal_bank
from lemma.tasks.language.template import GoalPairs


class Lesson(NamedTuple):
    """M sentences with their goals."""

    rows: NDArray[np.int32]
    """The words; see :meth:`lemma.policies.text.encoder.SentenceReader.rows`."""
    goals: list[GoalPairs]
    reasons: list[int]
    """Index of the reason for refusal of each sentence; -1 for an order."""


@dataclass(frozen=True)
class Lessons:
    """Draws the lesson of each step."""

    longest: int
    """Largest number of words in a sentence."""
    entities: EntitySet
    """Entities of the reader."""
    similar: int
    """Number of sentences to refuse, and of orders that look similar."""
    orders: int
    """Number of orders with goals of any task."""

    def draw(self, seed: int, step: int, rank: int = 0) -> Lesson:
        """Return the lesson of a step.

        Args:
            seed: Seed of the training.
            step: Number of the step.
            rank: Number of the process, if several share a training.
        """
        rng, bank = stream("lesson", seed, step, rank), refusal_bank()
        said = [bank.draw(rng) for _ in range(self.similar)]
        said += [(*draw_order(rng), -1) for _ in range(self.orders)]
        texts, goals, reasons = map(list, zip(*said, strict=True))
        rows = _reader(self.longest, self.entities).rows(texts)
        return Lesson(rows, goals, reasons)

    def ahead(
        self, steps: Sequence[int], seed: int, rank: int, workers: int
    ) -> Iterator[Lesson]:
        """Draw the lessons of some steps, in their order, in other processes.

        Args:
            steps: Numbers of the steps.
            seed: Seed of the training.
            rank: Number of the process, if several share a training.
            workers: Number of the processes.

        Raises:
            WorkerError: The processes cannot start, or die repeatedly.
        """
        jobs = [(self, seed, step, rank) for step in steps]
        return run_in_order(ProcessPool(workers), Lessons.draw, jobs)


@lru_cache(maxsize=4)
def _reader(longest: int, entities: EntitySet) -> SentenceReader:
    return SentenceReader(longest, entities)
