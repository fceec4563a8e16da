"""Write docs/results.md from the results that are committed.

Run from the repository: ``python scripts/results.py``. Without results, the page says
that nothing was run.
"""

from pathlib import Path

from lemma.evaluation.report.policy_results import entries_of, read_results
from lemma.evaluation.report.sections import page

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
PAGE = ROOT / "docs" / "results.md"


def text() -> str:
    """Return the page."""
    results = read_results([RESULTS]) if RESULTS.exists() else []
    entries = entries_of(results, complete=True)
    return page(entries, source="the files in `results/`", guide="[](evaluation.md)")


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
