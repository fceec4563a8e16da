"""The worker pool: many calls of one function, in several processes of this machine.

A job is a plain function of plain arguments. Return values come back in the order in
which jobs end; earlier reports, such as progress, come back at once. A Ray cluster does
the same for many machines, see :mod:`lemma.core.workers.ray_cluster`.
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
    """Hold Ctrl-C back, here for a moment and in processes started now for good.

    The terminal sends it to all of them, and each would die with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # The mask is inherited, yet it is of this thread alone: another one may take the
    # signal, and then Python calls the handler here all the same.
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
"""How many workers may die of one job."""
_WORKER = "LEMMA_WORKER"
"""Environment variable that is set in worker processes."""
_END_S = 2.0
"""How long a worker that has nothing left to do may take to end [s]."""


class Engine(Protocol):
    """Runs jobs."""

    @property
    def workers(self) -> int:
        """How many jobs run at a time."""
        ...

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ...,
    ) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end.

        Args:
            function: Function that every job calls; it belongs to a module.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, before that has ended.
        """
        ...


def ignore(message: Any) -> None:
    """Take no notice."""


_listener: Listener = ignore
"""The listener to reports of the job in this process."""


def report(message: Any) -> None:
    """Report to the caller of this job before it ends: that a part of it is done.

    Args:
        message: Anything that can be pickled. Outside of a job nobody hears it.
    """
    _listener(message)


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let somebody hear what is reported in this process meanwhile."""
    global _listener
    before, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = before


def run_in_order(
    engine: Engine, function: Callable[..., Any], jobs: Sequence[Job]
) -> Iterator[Any]:
    """Yield what each job returned, in the order of the jobs.

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
    """Return the number of a job, and what the job returned."""
    return number, function(*job)


class ProcessPool:
    """Runs jobs in several processes of this machine.

    A process that dies is replaced, and its job is done again. Processes are killed
    when the iteration ends before its time: by an error, by Ctrl-C, or because nobody
    goes on with it. Ctrl-C itself does not reach them.
    """

    def __init__(self, workers: int | None = None) -> None:
        """Set the number of processes.

        Args:
            workers: Most processes at a time; as many as there are cores if None.

        Raises:
            InvalidConfigError: Fewer than one.
        """
        self.workers = usable_cores() if workers is None else workers
        if self.workers < 1:
            raise InvalidConfigError(f"Workers are 1 or more, not {workers}.")

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ignore,
    ) -> Iterator[Any]:
        """Yield what each job returned, in the order in which they end.

        Args:
            function: Function that every job calls; it belongs to a module.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, in the order of arrival.

        Raises:
            WorkerError: Processes keep dying of a job, or cannot begin at all.
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
        """Deal with one message of a worker, or with its death; yield a result.

        Raises:
            WorkerError: It was one death too many, or it could not begin.
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
    """A job, and how many workers died of it."""

    function: Callable[..., Any]
    job: Job
    deaths: int = 0

    def outlive(self) -> None:
        """Count a death.

        Raises:
            WorkerError: It was one too many.
        """
        self.deaths += 1
        if self.deaths == MOST_DEATHS:
            raise WorkerError(
                f"{MOST_DEATHS} worker processes died, one after another, of the same "
                "job. If the system ends them for lack of memory, use fewer with "
                "--workers; each needs 500 MB."
            )


class _Worker:
    """A process of its own at the other end of a pipe, which does one job at a time."""

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
        """Return the next message; None if it died."""
        with suppress(EOFError, OSError):
            message: tuple[str, Any] = self.pipe.recv()
            return message
        return None

    def check_begun(self) -> None:
        """Check, of a process that died, that it was not the program that ended it.

        Raises:
            WorkerError: It ended by itself before it could be given any job.
        """
        # A signal, such as that for lack of memory, gives a negative code.
        if self.begun or (self.process.exitcode or 0) < 0:
            return
        raise WorkerError(
            "A worker process ended before it could begin; what it printed says why. "
            "Each imports the program that starts it: what a script does goes under "
            "'if __name__ == \"__main__\":', or every worker does it again."
        )

    def begin(self, task: _Task) -> None:
        """Send a job."""
        self.task = task
        # If the process is gone already, that shows when it is listened to.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send((task.function, task.job))


_working: set[_Worker] = set()
"""All workers of this process: it must not end before them, and wait for them."""


def _hire(team: set[_Worker]) -> _Worker:
    """Start a worker of a team."""
    # The first worker would start it, and that lets go of interrupts.
    resource_tracker.ensure_running()
    with interrupts_held():
        worker = _Worker()
        team.add(worker)
        _working.add(worker)
    return worker


def _wait_for_any(team: set[_Worker]) -> list[_Worker]:
    """Wait until workers say something or die; return those."""
    # A pipe alone may stay open behind a dead worker: what it started may hold it.
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
    """End workers, by force where they take longer.

    Args:
        team: The workers.
        patience_s: How long one may take to end by itself [s]; 0 to kill it.
    """
    # A second Ctrl-C must not leave some of them.
    with interrupts_held():
        for worker in team:
            worker.pipe.close()
        for worker in team:
            if patience_s > 0.0:
                worker.process.join(patience_s)
            worker.process.kill()
            worker.process.join()
            _working.discard(worker)


# Before multiprocessing's own, which was registered first and waits for every process.
atexit.register(lambda: _end(set(_working)))


def is_worker() -> bool:
    """Return whether this process works for another, beside others."""
    return _WORKER in os.environ


def become_worker() -> None:
    """Note that this process works for another."""
    os.environ[_WORKER] = "1"


def _work(pipe: "Connection[Any, Any]") -> None:
    """Do jobs until nobody asks any more."""
    become_worker()
    threading.Thread(target=_die_with_parent, daemon=True).start()
    # A closed pipe means that there is no more.
    gone = suppress(EOFError, ConnectionResetError, BrokenPipeError)
    with gone, heard_by(lambda message: pipe.send(("report", message))):
        pipe.send(("begun", None))
        while True:
            pipe.send_bytes(_answer(pipe))


def _answer(pipe: "Connection[Any, Any]") -> bytes:
    """Return what comes of the next job.

    Raises:
        EOFError: There is none.
    """
    request = pipe.recv_bytes()
    try:
        # First of all: a job may be made of things that a plugin has registered.
        load_plugins()
        function, job = pickle.loads(request)
        return pickle.dumps(("result", function(*job)))
    except BaseException as error:
        return pickle.dumps(("error", _portable(error)))


def _portable(error: BaseException) -> BaseException:
    """Return an exception as it can be sent, with a note where it comes from."""
    error.add_note("In a worker: " + "".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return WorkerError(f"{type(error).__name__} in a worker process: {error}")
    return error


def _die_with_parent() -> None:
    """End this process as soon as its parent is gone, however it went."""
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
        """Yield what each job returned.

        Args:
            function: Function that every job calls.
            jobs: Arguments of each call.
            on_report: Called with each report of a job, before that has ended.
        """
        for job in jobs:
            with heard_by(on_report):
                result = function(*job)
            yield result
