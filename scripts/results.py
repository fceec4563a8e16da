"""Write docs/results.md, and the table in README.md, from the results in results/.

Run from the repository: ``python scripts/results.py``. Without results, the page and
the README say that nothing was run.
"""

from pathlib import Path

from lemma.evaluation.experiments.catalog import SUITES
from lemma.evaluation.report.learning_curves import read_curves
from lemma.evaluation.report.policy_results import (
    PolicyResults,
    entries_of,
    read_results,
)
from lemma.evaluation.report.sections import HOW, page, protocol_words, sample_words
from lemma.evaluation.report.success_tables import at_a_glance

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
PAGE = ROOT / "docs" / "results.md"
README = ROOT / "README.md"
BEGIN, END = "<!-- results -->\n", "<!-- /results -->\n"
NOTHING = (
    "There are no results of this version yet. `lemma reproduce all` makes them from "
    "weights\nthat ship, `lemma reproduce all --print` says how those are trained.\n"
)


def entries(results: Path = RESULTS) -> list[PolicyResults]:
    """Return what a folder of results holds, with the rows that are missing."""
    found = read_results([results]) if results.exists() else []
    return entries_of(found, complete=True)


def text(results: Path = RESULTS) -> str:
    """Return the page."""
    told = "the files in `results/`"
    curves = read_curves(results)
    return page(entries(results), source=told, guide="[](evaluation.md)", curves=curves)


def headline(results: Path = RESULTS) -> str:
    """Return what the README says of results: rows of the paper, and ours."""
    played = [
        entry
        for entry in entries(results)
        if entry.results
        and (entry.experiment is None or entry.experiment.suite in SUITES[:2])
    ]
    if not played:
        return NOTHING
    how = f"[{HOW}](docs/results.md#{'-'.join(HOW.lower().split())})"
    told = f"{protocol_words(played, how)} {sample_words(played)}".strip()
    return f"{told}\n\n{at_a_glance(played).markdown()}"


def readme(results: Path = RESULTS) -> str:
    """Return the README with its table made anew."""
    before, found, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        raise SystemExit(f"{README} has no lines {BEGIN.strip()} and {END.strip()}.")
    return f"{before}{BEGIN}{headline(results)}{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
    README.write_text(readme(), encoding="utf-8")
