"""`lemma report`: a page with tables, figures and failures of results."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.options import Flag, Number, Results, Word, complain, output
from lemma.cli.workers import progress_bar
from lemma.core.errors import DatasetError, InvalidConfigError, RenderingError
from lemma.core.files import write_text
from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import usable_cores
from lemma.evaluation.report.episodes import Case, cases_of, spread
from lemma.evaluation.report.policy_results import (
    PolicyResults,
    entries_of,
    read_results,
)
from lemma.evaluation.report.sections import REPORT, page
from lemma.scene.rendering.gl_backend import choose_backend
from lemma.viz.pages.report import PAGE, Findings, write_report_page
from lemma.viz.pages.report_figures import FIGURES, figures_of, write_figures
from lemma.viz.pages.report_pictures import Pictures, picture_all

MOST_MB = 16.0
"""Largest size of all pictures of a page [MB]. Their encoding adds a third, and the
data of episodes some MB."""
VIDEOS = "videos"
REPLAYS = "replays"
_AT_INTERRUPT = (
    "no page was written, and pictures are not saved. '--failures 0' draws none."
)


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """Selection of the failures with pictures."""

    failures: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """Number of failed episodes per policy with pictures; 0 for none."""
    episode: Word = None
    """Only this episode of each policy: KIND/TASK/NUMBER, such as unseen/stack/12."""
    videos: Flag = False
    """Add a video of each episode with pictures, which takes some seconds each."""
    no_replays: Flag = False
    """Leave out interactive replays of these episodes, which need the extra play but no
    OpenGL."""
    workers: Number = None
    """Number of rendering processes; one per core by default."""


_DEFAULT = ReportOptions()


def report(
    results: Results,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("report"),
    complete: Flag = False,
    wishes: Annotated[ReportOptions, tyro.conf.arg(name="")] = _DEFAULT,
) -> int:
    """Write results as a page with tables, figures and failures, and as Markdown.

    The tables need only the summaries: the paper's four tables with its numbers below
    ours, unseen templates, ablations, causes of failure and errors of poses. If there
    are lines of episodes, failed episodes are played again from them, without their
    policy, and drawn.

    Args:
        results: Results of lemma evaluate or lemma reproduce: files, or folders that
            contain some at any depth.
        out: Folder for the page index.html, for results.md and the figures.
        complete: Also list the experiments that were not run.
        wishes: Selection of the failures with pictures.
    """
    if wishes.failures < 0:
        raise InvalidConfigError(f"--failures is at least 0, not {wishes.failures}.")
    if not (results or complete):
        raise InvalidConfigError("Name a result, such as results/reachnet/seed-0.json.")
    read = read_results(results)
    if not read and not complete:
        named = ", ".join(map(str, results))
        raise DatasetError(
            f"There are no results in {named}. Name the output of 'lemma evaluate' or "
            "'lemma reproduce'; an unfinished run has no result yet."
        )
    entries = entries_of(read, complete=complete)
    cases, uncounted = cases_of(entries, results)
    for file in uncounted:
        complain(
            f"The lines in {file} belong to no reported result. Run 'lemma evaluate' "
            "to its end, which counts them."
        )
    found = _findings(cases, wishes, out)
    write_text(out / REPORT, page(entries))
    write_figures(out / FIGURES, figures_of(entries))
    write_report_page(out / PAGE, entries, found)
    print_written(out / REPORT, entries)
    console = output()
    console.print(f"Page: {out / PAGE}. Figures: {out / FIGURES}", soft_wrap=True)
    if found.missing:
        console.print(found.missing, soft_wrap=True)
    differing = sum(bool(one.differs) for one in found.pictures.values())
    if differing:
        complain(
            f"{differing} of {len(found.pictures)} episodes differ from their replays: "
            "they are from other versions or another kind of machine."
        )
    return 0


def print_written(path: Path, entries: list[PolicyResults]) -> None:
    """Print the path of the tables and their number of policies."""
    count = sum(bool(entry.results) for entry in entries)
    output().print(f"Policies with results: {count}. Tables: {path}", soft_wrap=True)


def choose(cases: Sequence[Case], wishes: ReportOptions) -> list[tuple[int, Case]]:
    """Return index and episode of the cases with pictures.

    Raises:
        InvalidConfigError: The named episode is missing or did not fail.
    """
    if wishes.episode is not None:
        name = wishes.episode.replace("-", "_")
        chosen = [case for case in cases if case.name == name and case.cause]
        if not chosen:
            raise InvalidConfigError(
                f"No episode {wishes.episode} failed in these results. Episodes are "
                "named KIND/TASK/NUMBER, such as high_level/stack/12. Their lines must "
                "be in the folder of the result."
            )
    else:
        groups: dict[str, list[Case]] = {}
        for case in cases:
            groups.setdefault(case.policy, []).append(case)
        chosen = [
            case for group in groups.values() for case in spread(group, wishes.failures)
        ]
    wanted = {id(case) for case in chosen if case.is_repeatable}
    return [(i, case) for i, case in enumerate(cases) if id(case) in wanted]


def _findings(cases: Sequence[Case], wishes: ReportOptions, out: Path) -> Findings:
    failed = sum(case.cause is not None for case in cases)
    chosen = choose(cases, wishes)
    if not chosen:
        return Findings(cases, missing=_left_out(failed, 0))
    replays = _replays(chosen, wishes, out)
    try:
        choose_backend()
    except RenderingError as error:
        complain(str(error))
        missing = "There are no pictures: OpenGL does not work here."
        return Findings(cases, replays=replays, missing=missing)
    videos = out / VIDEOS if wishes.videos else None
    with progress_bar("failures", len(chosen), _AT_INTERRUPT) as advance:
        drawn = picture_all(chosen, videos, wishes.workers or usable_cores(), advance)
    kept = within(drawn, MOST_MB * 1e6)
    return Findings(cases, kept, _left_out(failed, len(kept)), replays)


def _replays(
    chosen: list[tuple[int, Case]], wishes: ReportOptions, out: Path
) -> dict[int, str]:
    """Write replays of episodes; return file names relative to the report's folder."""
    if wishes.no_replays or not (find_spec("viser") and find_spec("trimesh")):
        return {}
    from lemma.viewer.replays import write_cases

    engine = ProcessPool(wishes.workers or usable_cores())
    with progress_bar("replays", len(chosen), _AT_INTERRUPT) as advance:
        written = write_cases(chosen, out / REPLAYS, engine, advance)
    return {number: f"{REPLAYS}/{name}" for number, name in written.items()}


def within(drawn: dict[int, Pictures], most_bytes: float) -> dict[int, Pictures]:
    """Return pictures up to a total size; drop episodes evenly beyond it.

    Args:
        drawn: The pictures, by number of the episode.
        most_bytes: Largest total size [bytes].
    """
    numbers = sorted(drawn)
    total = sum(one.size for one in drawn.values())
    room = min(len(numbers), int(len(numbers) * most_bytes / max(total, 1)))
    picked = {numbers[i * len(numbers) // room] for i in range(room)}
    return {number: drawn[number] for number in numbers if number in picked}


def _left_out(failed: int, pictured: int) -> str:
    if failed == pictured:
        return ""
    return (
        f"{pictured} of {failed} failed episodes have pictures, "
        f"{failed - pictured} have none. 'lemma report --failures N' draws up to N per "
        "policy."
    )
