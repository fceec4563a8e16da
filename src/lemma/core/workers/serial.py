"""An engine without workers: jobs one after another in this process.

For what no other process can have, such as an object of a notebook, and for tests.
"""

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
