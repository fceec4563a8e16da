"""Where jobs run: in this process, in several, or on a Ray cluster.

A job is a plain function of plain arguments that writes its own result, so an engine
need only say which jobs are done.
"""

import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, Protocol

from lemma.core.errors import DatasetError, InvalidConfigError

Job = tuple[Any, ...]
"""Arguments of one call."""

_MOST_BREAKS = 5
_AHEAD = 2
_PATIENCE_S = 10.0
_WORKER = "LEMMA_WORKER"
"""Environment variable that is set in worker processes."""


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Engine(Protocol):
    """Runs jobs."""

    @property
    def workers(self) -> int:
        """How many jobs run at a time."""
        ...

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end."""
        ...


class Serial:
    """Runs jobs one after another in this process."""

    workers = 1

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned."""
        for job in jobs:
            yield function(*job)


class ProcessPool:
    """Runs jobs in several processes of this machine.

    A process that dies takes along what its fellows were doing; that is done again.
    """

    def __init__(self, workers: int) -> None:
        """Set the number of processes.

        Raises:
            InvalidConfigError: Fewer than one.
        """
        if workers < 1:
            raise InvalidConfigError(f"Workers are 1 or more, not {workers}.")
        self.workers = workers

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end.

        Raises:
            DatasetError: Processes keep dying.
        """
        left = dict(enumerate(jobs))
        breaks = 0
        while left:
            before = len(left)
            try:
                for number, result in self._once(function, dict(left)):
                    del left[number]
                    yield result
            except BrokenProcessPool as error:
                # As long as something is done in between, it is worth going on.
                breaks = 0 if len(left) < before else breaks + 1
                if breaks == _MOST_BREAKS:
                    raise DatasetError(
                        f"Worker processes died {_MOST_BREAKS} times before any of "
                        "them finished an episode. If the system ends them for lack "
                        "of memory, use fewer with --workers; each needs 500 MB."
                    ) from error

    def _once(
        self, function: Callable[..., Any], jobs: dict[int, Job]
    ) -> Iterator[tuple[int, Any]]:
        """Yield numbers of jobs and results until all are done.

        Raises:
            BrokenProcessPool: A process died.
        """
        waiting = iter(jobs.items())
        running: dict[Future[Any], int] = {}
        pool = ProcessPoolExecutor(
            min(self.workers, len(jobs)),
            mp_context=get_context("spawn"),
            initializer=_become_worker,
        )
        try:
            while True:
                while len(running) < _AHEAD * self.workers and (
                    following := next(waiting, None)
                ):
                    number, job = following
                    with _interrupts_held():
                        running[pool.submit(function, *job)] = number
                if not running:
                    return
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield running.pop(future), future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back, here for a moment and in processes started now for good.

    The terminal sends it to all of them, and each would die with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def is_worker() -> bool:
    """Return whether this process works for another, beside others."""
    return _WORKER in os.environ


def _become_worker() -> None:
    os.environ[_WORKER] = "1"
    _die_with_parent()


def _work_for_another(function: Callable[..., Any], *job: Any) -> Any:
    os.environ[_WORKER] = "1"
    return function(*job)


def _die_with_parent() -> None:
    """End this process as soon as its parent is gone, however it went."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def peak_memory_mb() -> float:
    """Return the most memory that this process ever held [MB]."""
    try:
        # Unlike getrusage, this does not count the process that started this one.
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    except (OSError, IndexError, ValueError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # Bytes on macOS, kilobytes elsewhere.
        return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


class RayCluster:
    """Runs jobs on a Ray cluster whose machines share a file system."""

    def __init__(self, address: str) -> None:
        """Connect to a cluster, or use the one that this process is connected to.

        Args:
            address: Of the cluster, or ``"auto"``.

        Raises:
            DatasetError: Ray is not installed, or there is no such cluster.
        """
        try:
            import ray  # noqa: PLC0415 - an extra, used here alone
        except ImportError as error:
            raise DatasetError(
                "Ray is not installed. Install it with: pip install "
                "'lemma-bench[scale]'."
            ) from error
        self._ray = ray
        try:
            if not ray.is_initialized():
                _knock(address)
                ray.init(address=address, log_to_driver=False, logging_level="warning")
        except (OSError, ValueError, ray.exceptions.RayError) as error:
            raise DatasetError(
                f"There is no Ray cluster at {address!r}: {str(error).rstrip('.')}. "
                "Start one with 'ray start --head', or use --engine processes."
            ) from error

    @property
    def workers(self) -> int:
        """Cores of the cluster."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def run(self, function: Callable[..., Any], jobs: Sequence[Job]) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end.

        Raises:
            DatasetError: Machines of the cluster keep dying.
            LemmaError: What a job raised.
        """
        # A machine that dies takes along its jobs; others do them again.
        remote = self._ray.remote(max_retries=_MOST_BREAKS)(_work_for_another)
        most = _AHEAD * self.workers
        waiting = iter(jobs)
        running: list[Any] = []
        while True:
            while len(running) < most and (job := next(waiting, None)) is not None:
                running.append(remote.remote(function, *job))
            if not running:
                return
            done, running = self._ray.wait(running)
            try:
                results = self._ray.get(done)
            except self._ray.exceptions.RayTaskError as error:
                # The cause alone: the message of the wrapper is a traceback.
                raise error.cause from error
            except self._ray.exceptions.RayError as error:
                raise DatasetError(
                    f"The Ray cluster lost a job {_MOST_BREAKS} times, or itself: "
                    f"{_first_line(error)}. What was written is kept: look after the "
                    "cluster ('ray status') and run the same command again."
                ) from error
            yield from results


def _knock(address: str) -> None:
    """Check that somebody listens at an address; Ray alone would try for minutes.

    Raises:
        OSError: Nobody does.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", address)
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S).close()


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0].rstrip(".")
