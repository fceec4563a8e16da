"""The command line, in this process."""

from unittest.mock import patch

import pytest

from lemma.cli import workers
from lemma.cli.main import main
from lemma.core.workers.pool import ProcessPool, Serial


class _Here(Serial):
    """In place of processes, each of which takes two seconds to start."""

    def __init__(self, processes: int | None) -> None:
        ProcessPool(processes)


def run(*words: object, processes: bool = False) -> int | str | None:
    """Run ``lemma`` with some words and return its exit code.

    Args:
        words: Of the command line.
        processes: Whether workers are processes; else this one works.
    """
    pool = ProcessPool if processes else _Here
    with (
        patch.object(workers, "ProcessPool", pool),
        pytest.raises(SystemExit) as end,
    ):
        main([str(word) for word in words])
    return end.value.code
