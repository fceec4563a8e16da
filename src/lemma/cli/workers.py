"""Options of worker processes, and the progress bar of verbs with many episodes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from lemma.cli.options import Number, messages
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Engine, ProcessPool
from lemma.core.workers.ray_cluster import RayCluster

_RATE_PERIOD_S = 60.0

AT_INTERRUPT = (
    "{done} of {total} episodes are saved. The same command continues from there."
)
"""Message after an interrupt of a job that resumes."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Options of the workers."""

    workers: Number = None
    """Number of processes on this machine; one per core by default."""
    engine: Literal["processes", "ray"] = "processes"
    """processes: on this machine; ray: a Ray cluster with access to the folder."""
    ray_address: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "auto"
    """Address of the Ray cluster."""

    def make_engine(self) -> Engine:
        """Return the engine.

        Raises:
            InvalidConfigError: The number of processes is below one, or given with Ray.
            WorkerError: Ray is not installed, or there is no cluster.
        """
        if self.engine == "ray":
            if self.workers is not None:
                raise InvalidConfigError(
                    "--workers is for processes on this machine; Ray uses all cores "
                    "of its cluster. Leave out one of the two."
                )
            return RayCluster(self.ray_address)
        return ProcessPool(self.workers)


DEFAULT = Workers()
"""One process per core."""

WorkerOptions = Annotated[Workers, tyro.conf.arg(name="")]
"""The fields as options of a verb."""


class _Rate(ProgressColumn):
    """Number of finished items per second."""

    def render(self, task: Task) -> Text:
        """Return the rate; empty text before the first item is finished."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s")


@contextmanager
def progress_bar(
    what: str, total: int | None, at_interrupt: str
) -> Iterator[Callable[[int], None]]:
    """Show a bar with rate and time left on the error stream.

    Args:
        what: Label of the bar, one or two words.
        total: Number of items; None if unknown.
        at_interrupt: Message after Ctrl-C, which says what is saved and how to
            continue. It may contain ``{done}`` and ``{total}``.

    Yields:
        A function to call with the number of newly finished items.

    Raises:
        KeyboardInterrupt: After Ctrl-C, with the message.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=messages(), speed_estimate_period=_RATE_PERIOD_S
    ) as progress:
        task = progress.add_task(what, total=total)
        done = 0

        def advance(count: int) -> None:
            nonlocal done
            done += count
            progress.advance(task, count)

        try:
            yield advance
        except KeyboardInterrupt:
            text = at_interrupt.format(done=done, total=total)
            raise KeyboardInterrupt(f"Interrupted: {text}") from None
