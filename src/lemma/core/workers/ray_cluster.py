"""The worker pool of many machines: a Ray cluster, which needs an extra."""

import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lemma.core.arguments import without_passwords
from lemma.core.errors import WorkerError
from lemma.core.plugins import load_plugins
from lemma.core.workers.pool import (
    MOST_DEATHS,
    Job,
    Listener,
    become_worker,
    heard_by,
    ignore,
)

_AHEAD = 2
"""Jobs per core that are submitted to the cluster in advance."""
_PATIENCE_S = 10.0


class RayCluster:
    """Runs jobs on a Ray cluster whose machines share a file system."""

    def __init__(self, address: str) -> None:
        """Connect to a cluster, or use the existing connection of this process.

        Args:
            address: Address of the cluster, or ``"auto"``.

        Raises:
            WorkerError: Ray is not installed, or there is no such cluster.
        """
        try:
            import ray  # noqa: PLC0415 - an extra, used here alone
        except ImportError as error:
            raise WorkerError(
                "Ray is not installed. Install it with: pip install "
                "'lemma-bench[scale]'."
            ) from error
        self._ray = ray
        try:
            if not ray.is_initialized():
                _check_reachable(address)
                ray.init(address=address, log_to_driver=False, logging_level="warning")
        except (OSError, ValueError, ray.exceptions.RayError) as error:
            where = without_passwords(address)
            raise WorkerError(
                f"There is no Ray cluster at {where!r}: {_first_line(error)}. "
                "Start one with 'ray start --head', or use --engine processes."
            ) from error

    @property
    def workers(self) -> int:
        """Number of cores of the cluster."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

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
            on_report: Called with all reports of a job when the job has ended.

        Raises:
            WorkerError: Machines of the cluster fail repeatedly.
            LemmaError: The error that a job raised.
        """
        # Jobs of a failed machine are repeated on other machines.
        remote = self._ray.remote(max_retries=MOST_DEATHS)(_work_for_another)
        # Workers of a cluster do not inherit the environment and sys.path.
        here = (load_plugins(), tuple(sys.path))
        most = _AHEAD * self.workers
        waiting = iter(jobs)
        running: list[Any] = []
        while True:
            while len(running) < most and (job := next(waiting, None)) is not None:
                running.append(remote.remote(here, function, *job))
            if not running:
                return
            done, running = self._ray.wait(running)
            for reports, result in self._results(done):
                for message in reports:
                    on_report(message)
                yield result

    def _results(self, done: list[Any]) -> list[tuple[list[Any], Any]]:
        try:
            results: list[tuple[list[Any], Any]] = self._ray.get(done)
        except self._ray.exceptions.RayTaskError as error:
            # Raise the cause, because the message of Ray's wrapper is a traceback.
            raise error.cause from error
        except self._ray.exceptions.RayError as error:
            raise WorkerError(
                f"The Ray cluster lost a job {MOST_DEATHS} times, or failed: "
                f"{_first_line(error)}. Finished work is kept: check the cluster "
                "('ray status') and run the same command again."
            ) from error
        return results


def _work_for_another(
    there: tuple[tuple[str, ...], tuple[str, ...]],
    function: Callable[..., Any],
    *job: Any,
) -> tuple[list[Any], Any]:
    """Run a job; return its reports and its return value.

    Args:
        there: Plugins and ``sys.path`` of the calling process.
        function: Function to call.
        *job: Its arguments.
    """
    become_worker()
    plugins, folders = there
    sys.path += [folder for folder in folders if folder not in sys.path]
    load_plugins(plugins)
    reports: list[Any] = []
    with heard_by(reports.append):
        result = function(*job)
    return reports, result


def _check_reachable(address: str) -> None:
    """Check that a server listens at an address, because Ray would retry for minutes.

    Raises:
        OSError: No server listens there.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", address)
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S).close()


def _first_line(error: Exception) -> str:
    return without_passwords(str(error).strip().partition("\n")[0].rstrip("."))
