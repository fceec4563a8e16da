"""The worker pool: many calls of one function, in several processes of this machine.

A job is one call of the function. Return values arrive in the order in which jobs end;
reports of a job, such as progress, arrive at once. For a Ray cluster of many machines
see :mod:`lemma.core.workers.ray_cluster`.
"""

import atexit
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from lemma.core.errors import InvalidConfigError, WorkerError
from lemma.core.plugins import load_plugins
from lemma.core.workers.resources import usable_cores


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay Ctrl-C until the end of the block; processes started in it never get it.

    The terminal sends it to all processes, and workers would end with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # Child processes inherit the mask, but it holds for this thread alone: another
    # thread may get the signal, and Python still calls the handler in the main thread.
    handler = signal.getsignal(signal.SIGINT)
    is_ours = threading.current_thread() is threading.main_thread() and callable(
        handler
    )
    came: list[int] = []
    if is_ours:
        signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if came:
            signal.raise_signal(signal.SIGINT)


Job = tuple[Any, ...]
"""Arguments of one call."""
Listener = Callable[[Any], None]
"""Called with each report of a job."""

MOST_DEATHS = 5
"""Number of workers that may die during one job."""
_WORKER = "LEMMA_WORKER"
"""Environment variable that is set in worker processes."""
_END_S = 2.0
"""Longest time for a worker without jobs to end [s]."""


class Engine(Protocol):
    """Runs jobs."""

    @property
    def workers(self) -> int:
        """Number of jobs that run at the same time."""
        ...

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ...,
    ) -> Iterator[Any]:
        """Yield the return value of each job, in the order in which they end.

        Args:
            function: Function that every job calls, at the top level of a module.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, before the job has ended.
        """
        ...


def ignore(message: Any) -> None:
    """Ignore a report."""


_listener: Listener = ignore
"""The listener for reports of the job in this process."""


def report(message: Any) -> None:
    """Send a report of this job, such as progress, before the job ends.

    Args:
        message: Any object that can be pickled. Outside of a job it is ignored.
    """
    _listener(message)


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Pass reports in this process to a listener, inside the block."""
    global _listener
    before, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = before


def run_in_order(
    engine: Engine, function: Callable[..., Any], jobs: Sequence[Job]
) -> Iterator[Any]:
    """Yield the return value of each job, in the order of the jobs.

    Args:
        engine: Workers that run the jobs.
        function: Function that every job calls.
        jobs: Arguments of each call.
    """
    early: dict[int, Any] = {}
    following = 0
    listed = [(number, function, job) for number, job in enumerate(jobs)]
    for number, result in engine.run(numbered, listed):
        early[number] = result
        while following in early:
            yield early.pop(following)
            following += 1


def numbered(number: int, function: Callable[..., Any], job: Job) -> tuple[int, Any]:
    """Run a job; return its number and its return value."""
    return number, function(*job)


class ProcessPool:
    """Runs jobs in several processes of this machine.

    A process that dies is replaced, and its job is repeated. If the iteration ends
    early, by an error, by Ctrl-C or because it is abandoned, the processes are killed.
    They do not get Ctrl-C themselves.
    """

    def __init__(self, workers: int | None = None) -> None:
        """Set the number of processes.

        Args:
            workers: Largest number of processes; the number of usable cores if None.

        Raises:
            InvalidConfigError: The number is below 1.
        """
        self.workers = usable_cores() if workers is None else workers
        if self.workers < 1:
            raise InvalidConfigError(f"There must be 1 or more workers, not {workers}.")

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ignore,
    ) -> Iterator[Any]:
        """Yield the return value of each job, in the order in which they end.

        Args:
            function: Function that every job calls, at the top level of a module.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, in the order of arrival.

        Raises:
            WorkerError: Processes die repeatedly during a job, or cannot start.
        """
        waiting = deque(_Task(function, job) for job in jobs)
        team: set[_Worker] = set()
        try:
            for _ in range(min(self.workers, len(jobs))):
                _hire(team)
            for worker in tuple(team):
                worker.begin(waiting.popleft())
            while any(worker.task for worker in team):
                for worker in _wait_for_any(team):
                    yield from self._hear(worker, team, waiting, on_report)
        except BaseException:
            _end(team)
            raise
        _end(team, patience_s=_END_S)

    def _hear(
        self,
        worker: "_Worker",
        team: "set[_Worker]",
        waiting: "deque[_Task]",
        on_report: Listener,
    ) -> Iterator[Any]:
        """Process one message of a worker, or its death; yield a result if any.

        Raises:
            WorkerError: Too many workers died, or this one could not start.
        """
        message = worker.hear()
        if message is None:
            task = worker.task
            _end({worker})
            team.discard(worker)
            worker.check_begun()
            if task is not None:
                task.outlive()
                _hire(team).begin(task)
            return
        kind, content = message
        if kind == "begun":
            worker.begun = True
            return
        if kind == "report":
            on_report(content)
            return
        if kind == "error":
            raise content
        worker.task = None
        if waiting:
            worker.begin(waiting.popleft())
        yield content


@dataclass(slots=True, eq=False)
class _Task:
    """A job, and the number of workers that died during it."""

    function: Callable[..., Any]
    job: Job
    deaths: int = 0

    def outlive(self) -> None:
        """Count a death.

        Raises:
            WorkerError: Too many workers died.
        """
        self.deaths += 1
        if self.deaths == MOST_DEATHS:
            raise WorkerError(
                f"{MOST_DEATHS} worker processes died, one after another, during the "
                "same job. If the system ends them for lack of memory, use fewer with "
                "--workers; each needs 500 MB."
            )


class _Worker:
    """A process that runs one job at a time, connected by a pipe."""

    def __init__(self) -> None:
        # OpenGL does not survive a fork.
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,))
        self.process.start()
        theirs.close()
        self.task: _Task | None = None
        self.begun = False

    def hear(self) -> tuple[str, Any] | None:
        """Return the next message; None if the process died."""
        with suppress(EOFError, OSError):
            message: tuple[str, Any] = self.pipe.recv()
            return message
        return None

    def check_begun(self) -> None:
        """Check that a dead process had started or was killed by a signal.

        Raises:
            WorkerError: It ended by itself before it could get a job.
        """
        # The exit code is negative after a signal, such as that for lack of memory.
        if self.begun or (self.process.exitcode or 0) < 0:
            return
        raise WorkerError(
            "A worker process ended before it could begin; see its output above. Every "
            "worker imports the program that started it. If that is a script, put its "
            "code under 'if __name__ == \"__main__\":', or every worker runs it again."
        )

    def begin(self, task: _Task) -> None:
        """Send a job."""
        self.task = task
        # If the process is dead already, `hear` detects it.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send((task.function, task.job))


_working: set[_Worker] = set()
"""All workers of this process, which must be ended before it exits."""


def _hire(team: set[_Worker]) -> _Worker:
    """Start a worker of a team."""
    # Otherwise the first worker would start it, which unblocks interrupts.
    resource_tracker.ensure_running()
    with interrupts_held():
        worker = _Worker()
        team.add(worker)
        _working.add(worker)
    return worker


def _wait_for_any(team: set[_Worker]) -> list[_Worker]:
    """Wait until workers send a message or die; return those."""
    # Wait for the processes too: children of a dead worker may keep its pipe open.
    ends = {worker.process.sentinel: worker for worker in team}
    pipes = {worker.pipe: worker for worker in team}
    ready = set(wait([*pipes, *ends]))
    spoke = [worker for pipe, worker in pipes.items() if pipe in ready]
    died = [worker for end, worker in ends.items() if end in ready]
    for worker in died:
        if worker not in spoke:
            worker.pipe.close()
            spoke.append(worker)
    return spoke


def _end(team: set[_Worker], patience_s: float = 0.0) -> None:
    """End workers; kill those that take too long.

    Args:
        team: The workers.
        patience_s: Time for each worker to end by itself [s]; 0 kills it at once.
    """
    # A second Ctrl-C must not interrupt this.
    with interrupts_held():
        for worker in team:
            worker.pipe.close()
        for worker in team:
            if patience_s > 0.0:
                worker.process.join(patience_s)
            worker.process.kill()
            worker.process.join()
            _working.discard(worker)


# Runs before multiprocessing's own function, which waits for every process.
atexit.register(lambda: _end(set(_working)))


def is_worker() -> bool:
    """Return whether this process is a worker."""
    return _WORKER in os.environ


def become_worker() -> None:
    """Mark this process as a worker."""
    os.environ[_WORKER] = "1"


def _work(pipe: "Connection[Any, Any]") -> None:
    """Run jobs until the pipe is closed."""
    become_worker()
    threading.Thread(target=_die_with_parent, daemon=True).start()
    # A closed pipe means that there are no more jobs.
    gone = suppress(EOFError, ConnectionResetError, BrokenPipeError)
    with gone, heard_by(lambda message: pipe.send(("report", message))):
        pipe.send(("begun", None))
        while True:
            pipe.send_bytes(_answer(pipe))


def _answer(pipe: "Connection[Any, Any]") -> bytes:
    """Run the next job; return its pickled result or error.

    Raises:
        EOFError: There are no more jobs.
    """
    request = pipe.recv_bytes()
    try:
        # Load plugins first, because unpickling a job may need their records.
        load_plugins()
        function, job = pickle.loads(request)
        return pickle.dumps(("result", function(*job)))
    except BaseException as error:
        return pickle.dumps(("error", _portable(error)))


def _portable(error: BaseException) -> BaseException:
    """Return an exception that can be pickled, with the traceback as a note."""
    error.add_note("In a worker: " + "".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return WorkerError(f"{type(error).__name__} in a worker process: {error}")
    return error


def _die_with_parent() -> None:
    """End this process as soon as its parent has ended."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


class Serial:
    """Runs jobs one after another in this process."""

    workers = 1

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ignore,
    ) -> Iterator[Any]:
        """Yield the return value of each job, in order.

        Args:
            function: Function that every job calls.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, before the job has ended.
        """
        for job in jobs:
            with heard_by(on_report):
                result = function(*job)
            yield result
