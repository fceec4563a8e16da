"""An engine for tests: jobs in this process, so that what they call can be replaced."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lemma.core.workers.pool import Job, Listener, heard_by, ignore


class Serial:
    """Runs jobs one after another in this process."""

    workers = 1

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ignore,
    ) -> Iterator[Any]:
        """Yield what each job returned."""
        for job in jobs:
            with heard_by(on_report):
                result = function(*job)
            yield result


class Killed(BaseException):
    pass


class KilledAfter(Serial):
    """Does some jobs, and is gone."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def run(
        self,
        function: Callable[..., Any],
        jobs: Sequence[Job],
        on_report: Listener = ignore,
    ) -> Iterator[Any]:
        for number, result in enumerate(super().run(function, jobs, on_report)):
            if number == self.jobs:
                raise Killed
            yield result
