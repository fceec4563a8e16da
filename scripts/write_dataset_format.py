"""Write the columns into docs/dataset_format.md, as the code defines them.

    python scripts/write_dataset_format.py [--check]

With --check nothing is written; the exit code says whether the page is up to date.
"""

import sys
from pathlib import Path

from lemma.dataset.schema import describe

PAGE = Path(__file__).parents[1] / "docs" / "dataset_format.md"
START = "<!-- columns: written by scripts/write_dataset_format.py -->\n"
END = "<!-- end of columns -->\n"


def with_columns(page: str) -> str:
    """Return the page with the columns as they are now."""
    before, _, rest = page.partition(START)
    _, _, after = rest.partition(END)
    return f"{before}{START}\n{describe()}\n\n{END}{after}"


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
