"""Options for worker processes, and the progress bar of verbs with many episodes."""

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


@dataclass(frozen=True, slots=True)
class Workers:
    """Options of the workers."""

    workers: Number = None
    """Processes on this machine; one per core by default."""
    engine: Literal["processes", "ray"] = "processes"
    """Processes of this machine, or a Ray cluster that shares the folder."""
    ray_address: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "auto"
    """Address of the Ray cluster."""

    def make_engine(self) -> Engine:
        """Return the engine.

        Raises:
            InvalidConfigError: The number of processes is below one, or beside Ray.
            WorkerError: There is no Ray, or no cluster.
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
    """How many are done per second."""

    def render(self, task: Task) -> Text:
        """Return the rate, once there is one."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s")


@contextmanager
def progress_bar(
    what: str, total: int | None, at_interrupt: str
) -> Iterator[Callable[[int], None]]:
    """Show a bar with rate and time left on the error stream.

    Args:
        what: Label of the bar, a word or two.
        total: How many there are; None if that is not known.
        at_interrupt: Message after Ctrl-C: what is kept, and how to go on. It may
            name ``{done}`` and ``{total}``.

    Yields:
        A function that is told how many were done since it was last told.

    Raises:
        KeyboardInterrupt: With what to say.
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
