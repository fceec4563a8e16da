"""Write the columns of data sets into docs/dataset_format.md from the code.

    python scripts/write_dataset_format.py [--check]

With --check nothing is written; the exit code is 0 if the page is up to date.
"""

import sys
from pathlib import Path

from lemma.dataset.recipe.schema import describe

PAGE = Path(__file__).parents[1] / "docs" / "dataset_format.md"
BLOCKS = {"columns": describe(), "perturbed columns": describe(perturbed=True)}
"""Generated texts by name, as in the marks around them."""


def with_columns(page: str) -> str:
    """Return the page with the present columns."""
    for name, text in BLOCKS.items():
        start = f"<!-- {name}: written by scripts/write_dataset_format.py -->\n"
        end = f"<!-- end of {name} -->\n"
        before, _, rest = page.partition(start)
        _, _, after = rest.partition(end)
        page = f"{before}{start}\n{text}\n\n{end}{after}"
    return page


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    if sys.argv[1:] == ["--check"]:
        sys.exit(
            None
            if page == with_columns(page)
            else "docs/dataset_format.md is out of date: run "
            "scripts/write_dataset_format.py"
        )
    PAGE.write_text(with_columns(page), encoding="utf-8")
