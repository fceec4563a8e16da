"""Add a result to the leaderboard, or write docs/leaderboard.md from its entries.

Run from the repository:

    python scripts/leaderboard.py add DIR NAME --title TITLE --who WHO [--link URL]
    python scripts/leaderboard.py page
"""

import argparse
from pathlib import Path

from lemma.evaluation.report.leaderboard import (
    board_page,
    check_submission,
    read_board,
    submit,
)

ROOT = Path(__file__).parents[1]
BOARD = ROOT / "leaderboard"
PAGE = ROOT / "docs" / "leaderboard.md"


def text() -> str:
    """Return the page."""
    return board_page(read_board(BOARD))


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="The leaderboard.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    add = verbs.add_parser("add", help="add what lemma evaluate wrote")
    add.add_argument("folder", type=Path)
    add.add_argument("name")
    add.add_argument("--title", required=True)
    add.add_argument("--who", required=True)
    add.add_argument("--link", default="")
    verbs.add_parser("page", help="write the page")
    asked = parser.parse_args()
    if asked.verb == "add":
        told = {"title": asked.title, "who": asked.who, "link": asked.link}
        submit(asked.folder, BOARD, asked.name, **told)
        check_submission(BOARD, asked.name)
    PAGE.write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main()
