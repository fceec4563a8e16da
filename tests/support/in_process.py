"""An engine for tests that is gone after some jobs."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lemma.core.workers.pool import Job, Listener, Serial, ignore


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
