"""The command line, in this process."""

import pytest

from lemma.cli.main import main


def run(*words: object) -> int | str | None:
    """Run ``lemma`` with some words and return its exit code."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return end.value.code
