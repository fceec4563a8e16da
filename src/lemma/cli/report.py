"""`lemma report`: tables of results, as a page."""

from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.terminal import Flag, output
from lemma.dataset.files import write_text
from lemma.evaluation.entries import Entry, entries_of, read_results
from lemma.evaluation.report import REPORT, page

ResultPaths = Annotated[
    tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT ...")
]
"""Folders or files of results."""


def report(
    results: ResultPaths,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("report"),
    complete: Flag = False,
) -> int:
    """Write the tables of some results as a page in Markdown.

    The paper's four tables with its figures below ours, unseen templates, ablations,
    causes of failure and how exact poses are; made from the summaries alone.

    Args:
        results: What lemma evaluate or lemma reproduce wrote: files, or folders that
            hold some at any depth.
        out: Folder of the page.
        complete: Also name the experiments that were not run.
    """
    entries = entries_of(read_results(results), complete=complete)
    path = out / REPORT
    write_text(path, page(entries))
    print_written(path, entries)
    return 0


def print_written(path: Path, entries: list[Entry]) -> None:
    """Say where the tables are, and of how many policies they have results."""
    count = sum(bool(entry.results) for entry in entries)
    output().print(f"Policies with results: {count}. Tables: {path}", soft_wrap=True)
