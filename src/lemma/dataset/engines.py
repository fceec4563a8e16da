"""Where jobs run: in this process, in several, or on a Ray cluster.

A job is a plain function of plain arguments that writes its own result, so an engine
need only say which jobs are done.
"""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from typing import Any, Protocol

from lemma.core.errors import DatasetError

Job = tuple[Any, ...]
"""Arguments of one call."""

_MOST_BREAKS = 50
_AHEAD = 2


class Engine(Protocol):
    """Runs jobs."""

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end."""
        ...


class Serial:
    """Runs jobs one after another in this process."""

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned."""
        for job in jobs:
            yield function(*job)


class Processes:
    """Runs jobs in several processes of this machine.

    A process that dies takes one job along, which is run again.
    """

    def __init__(self, workers: int) -> None:
        """Set the number of processes."""
        self._workers = workers

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end.

        Raises:
            DatasetError: Processes keep dying.
        """
        left = list(jobs)
        for _ in range(_MOST_BREAKS):
            broken = False
            for job, result in self._once(function, tuple(left)):
                if job is None:
                    broken = True
                    break
                left.remove(job)
                yield result
            if not broken:
                return
        raise DatasetError(
            f"{_MOST_BREAKS} worker processes died. If the system ends them for lack "
            "of memory, use fewer with --workers; each needs about 500 MB."
        )

    def _once(
        self, function: Callable[..., Any], jobs: Sequence[Job]
    ) -> Iterator[tuple[Job | None, Any]]:
        """Yield jobs and results until all are done, or None when the pool broke."""
        waiting = iter(jobs)
        running: dict[Future[Any], Job] = {}
        with ProcessPoolExecutor(
            self._workers, mp_context=get_context("spawn"), initializer=_die_with_parent
        ) as pool:
            try:
                while True:
                    for job in waiting:
                        running[pool.submit(function, *job)] = job
                        if len(running) >= _AHEAD * self._workers:
                            break
                    if not running:
                        return
                    done, _ = wait(running, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield running.pop(future), future.result()
            except BrokenProcessPool:
                yield None, None
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _die_with_parent() -> None:
    """End this process as soon as its parent is gone, however it went."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Ray:
    """Runs jobs on a Ray cluster that shares a file system."""

    def __init__(self, address: str) -> None:
        """Connect to a cluster.

        Args:
            address: Of the cluster, or ``"auto"``.

        Raises:
            DatasetError: Ray is not installed.
        """
        try:
            import ray  # noqa: PLC0415 - an extra, used here alone
        except ImportError as error:
            raise DatasetError(
                "Ray is not installed. Install it with: pip install "
                "'lemma-bench[scale]'."
            ) from error
        self._ray = ray
        if not ray.is_initialized():
            ray.init(address=address, log_to_driver=False)

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end."""
        remote = self._ray.remote(max_retries=_MOST_BREAKS)(function)
        most = _AHEAD * max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        waiting = iter(jobs)
        running: list[Any] = []
        while True:
            for job in waiting:
                running.append(remote.remote(*job))
                if len(running) >= most:
                    break
            if not running:
                return
            done, running = self._ray.wait(running)
            yield from self._ray.get(done)
