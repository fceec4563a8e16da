"""Frames for training, rendered while it goes on: nothing is written to a disk.

Workers execute episodes of a recipe again, film them, and hand them over; whoever
trains takes batches of frames from several episodes. What is in memory are those
episodes, and one or a few per worker: workers wait while nobody asks for more.
"""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream as random_stream
from lemma.core.workers.pool import Engine, ProcessPool, run_in_order
from lemma.dataset.files import check_files
from lemma.dataset.instructions import RECORDED, Language
from lemma.dataset.recipe.files import open_table
from lemma.dataset.recipe.reader import Recipe, load
from lemma.dataset.recipe.replay import check_versions
from lemma.dataset.rendered.film import Filming, film
from lemma.scene.rendering.batch import choose_renderer

Sample = dict[str, Any]
"""Arrays by name, and the texts of an episode."""

_TEXTS = ("key", "task", "instruction")


@dataclass(frozen=True, kw_only=True)
class FrameStream:
    """The frames of a split of a recipe, in a new order in every epoch."""

    recipe: Path
    """Folder of the recipe."""
    split: str
    """Name of a split."""
    tasks: tuple[str, ...] = ()
    """Names of tasks; all of the split if empty."""
    how: Filming = field(default_factory=Filming)
    """How episodes are filmed; renderer ``"auto"`` is chosen when frames are asked
    for."""
    language: Language = RECORDED
    """Which sentence an episode is given as its instruction."""
    engine: Engine = field(default_factory=ProcessPool)
    """Where to work."""
    seed: int = 0
    """Of the orders of episodes and frames."""

    def episodes(self, epochs: Sequence[int] = (0,)) -> Iterator[Sample]:
        """Yield whole episodes, in an order drawn for each epoch.

        Args:
            epochs: Numbers of the epochs; each has an order of its own.

        Yields:
            ``rgb`` (frames, cameras, height, width, 3) uint8; with depth, ``depth_m``
            (frames, cameras, height, width) float32; ``state`` and ``action`` (frames,
            robots * 7) float32: of each robot six joint angles [rad] and the opening of
            the gripper [m], measured, and commanded by the next frame; ``subtask``
            (frames,) int16, -1 at the end; ``index`` (frames,) int32; and the texts
            ``key``, ``task`` and ``instruction``.

        Raises:
            DatasetError: The recipe cannot be read here, motion is not the recorded
                one, or sentences that are held out would be those of training.
            UnknownNameError: It has no such split or task, or there is no such camera.
            RenderingError: The renderer does not work here.
        """
        chosen = self._chosen()
        how = replace(self.how, renderer=choose_renderer(self.how.renderer))
        jobs = [
            (chosen[n], how, self.language, epoch)
            for epoch in epochs
            for n in random_stream("frames", self.seed, epoch).permutation(len(chosen))
        ]
        yield from run_in_order(self.engine, film_episode, jobs)

    def batches(
        self, size: int, epochs: Sequence[int] = (0,), mix: int = 8
    ) -> Iterator[Sample]:
        """Yield batches of frames, in an order drawn for each epoch.

        Args:
            size: Frames of a batch; the last one may have fewer.
            epochs: Numbers of the epochs. Workers go on from one to the next, and a
                batch may hold the end of one and the beginning of the next.
            mix: Episodes whose frames are shuffled together. All of them are in memory.

        Yields:
            What :meth:`episodes` yields, with frames of several episodes along the
            first axis, and a list of each text.

        Raises:
            InvalidConfigError: A batch would be empty.
            DatasetError: See :meth:`episodes`.
            UnknownNameError: See :meth:`episodes`.
            RenderingError: See :meth:`episodes`.
        """
        if min(size, mix) < 1:
            raise InvalidConfigError(
                f"Batches of {size} frames of {mix} episodes are none. Both numbers "
                "are 1 or more."
            )
        draws = random_stream("batches", self.seed, *epochs)
        held: list[Sample] = []
        left: list[tuple[Sample, int]] = []
        for episode in self.episodes(epochs):
            held.append(episode)
            if len(held) == mix:
                left = yield from _drawn(left, held, size, draws)
                held = []
        left = yield from _drawn(left, held, size, draws)
        if left:
            yield _stacked(left)

    def _chosen(self) -> list[Recipe]:
        """Return every episode by itself, once it is sure that they can be executed.

        Raises:
            DatasetError: They cannot.
            UnknownNameError: There is no such split or task.
        """
        recipe = load(self.recipe.absolute())
        check_files(recipe.folder, partial=True)
        splits = {path.parent.name for path in recipe.files()}
        recipe = recipe.select(split=known("split in this recipe", self.split, splits))
        stems = sorted({path.stem for path in recipe.files()})
        tasks = [known("task of this split", name, stems) for name in self.tasks]
        parts = [recipe.select(task=name) for name in tasks or stems]
        for path in (path for part in parts for path in part.files()):
            check_versions(open_table(path)[1])
        return [part[n : n + 1] for part in parts for n in range(len(part))]


def film_episode(
    recipe: Recipe, how: Filming, language: Language, epoch: int
) -> Sample:
    """Return the frames of the one episode of a recipe; see :class:`FrameStream`."""
    record = recipe[0]
    found: dict[str, list[Any]] = {
        name: [] for name in ("rgb", "state", "action", "subtask", "index")
    }
    depths = []
    for frame in film(record, how):
        step = frame.step
        state = np.concatenate([step.joints, step.opening_m[:, None]], axis=1)
        found["rgb"].append(frame.rgb)
        found["state"].append(state.ravel().astype(np.float32))
        found["action"].append(step.action.ravel().astype(np.float32))
        found["subtask"].append(np.int16(step.subtask))
        found["index"].append(np.int32(step.index))
        if frame.depth_m is not None:
            depths.append(frame.depth_m)
    return {
        **{name: np.array(values) for name, values in found.items()},
        **({"depth_m": np.array(depths)} if depths else {}),
        "key": record.key,
        "task": record.task,
        "instruction": language.choose(record, epoch),
    }


def _drawn(
    left: list[tuple[Sample, int]],
    held: Sequence[Sample],
    size: int,
    draws: np.random.Generator,
) -> Generator[Sample, None, list[tuple[Sample, int]]]:
    """Yield full batches of some episodes; return the frames that are left."""
    every = [(one, row) for one in held for row in range(len(one["index"]))]
    frames = left + [every[n] for n in draws.permutation(len(every)).tolist()]
    full = len(frames) - len(frames) % size
    for first in range(0, full, size):
        yield _stacked(frames[first : first + size])
    return frames[full:]


def _stacked(frames: Sequence[tuple[Sample, int]]) -> Sample:
    names = frames[0][0]
    return {
        name: [one[name] for one, _ in frames]
        if name in _TEXTS
        else np.stack([one[name][row] for one, row in frames])
        for name in names
    }
