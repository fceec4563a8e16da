"""The leaderboard: every entry is what its lines say, and nothing else gets in."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from made_up import ABOUT, row, step

from leaderboard import (
    PAGE,
    board_page,
    check_submission,
    leaders,
    read_board,
    submission_of,
    submit,
    text,
)
from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.evaluation.analysis.result import Result, summarise
from lemma.evaluation.lines import read_lines, write_packed
from lemma.evaluation.run.protocol import quote
from lemma.tasks.suite import SUITE, load_instance

ROOT = Path(__file__).parents[3]
BOARD = ROOT / "leaderboard"
LEARNED = {"name": "package.module:Mine", "planning": "single-step", "gta": False}
TOLD = {"title": "Mine", "who": "Me", "link": "https://example.org"}


def lines(successes: int = 30) -> list[dict[str, Any]]:
    """Return the lines of all test episodes of which so many of each task succeed."""
    return [
        row(
            task,
            index,
            success=index < successes,
            steps=[step(1)],
            left=int(index >= successes),
            instruction=load_instance(task, "test", index).instructions["high_level"],
            **later(index < successes + 2),
        )
        for task in SUITE
        for index in range(60)
    ]


def later(success: bool) -> dict[str, Any]:
    """Return what a line says of the lenient verdict."""
    told = row(success=success)["lenient"]
    return {"lenient": told}


def result(rows: list[dict[str, Any]], **about: object) -> Result:
    told = {**ABOUT, "policy": LEARNED, "protocol": quote(), **about}
    return summarise(rows, told, "lemma evaluate")


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """Return a leaderboard with one entry, called mine."""
    return submitted(tmp_path, "result/summary.json")


def submitted(tmp_path: Path, summary: str) -> Path:
    """Return a leaderboard with one entry whose summary lay in a file of that name."""
    folder = tmp_path / "result"
    folder.mkdir()
    made = result(lines())
    made.write(tmp_path / summary)
    (folder / "about.json").write_text(json.dumps(made.about))
    text = "".join(json.dumps(one) + "\n" for one in lines())
    (folder / "episodes.jsonl").write_text(text)
    submit(folder, tmp_path / "board", "mine", **TOLD)
    return tmp_path / "board"


def test_weights_that_a_clock_made_are_refused() -> None:
    weights = {"sha256": "a" * 64, "seed": 0, "data": {}}
    submission_of(result(lines(), weights={"reachnet": weights}), "Mine", "Me")
    limited = {"reachnet": {**weights, "ended": "time limit"}}
    with pytest.raises(InvalidConfigError, match="without --time-limit-s"):
        submission_of(result(lines(), weights=limited), "Mine", "Me")


def test_every_entry_is_what_its_lines_say() -> None:
    for name in read_board(BOARD):
        check_submission(BOARD, name)


def test_the_page_is_made_from_the_entries() -> None:
    assert text() == PAGE.read_text(encoding="utf-8"), (
        "docs/leaderboard.md is out of date: python scripts/leaderboard.py page"
    )


def test_an_entry_passes_its_check(board: Path) -> None:
    check_submission(board, "mine")
    entry = read_board(board)["mine"]
    assert entry.success["high_level"]["mean"] == 50.0
    assert entry.success["high_level"]["tasks"] == dict.fromkeys(SUITE, 30)
    (line,) = leaders(read_board(board), "high_level", truth=False).rows
    assert line[:3] == ("[Mine](https://example.org)", "Me", "50.0")
    # Half of them strictly, and two more of each task leniently.
    assert line[-3:-1] == ("50.0 (46–54)", "53.3")
    assert leaders(read_board(board), "human", truth=False).rows == ()
    assert leaders(read_board(board), "high_level", truth=True).rows == ()


def test_what_reproduce_wrote_can_be_handed_in_too(tmp_path: Path) -> None:
    check_submission(submitted(tmp_path, "result.json"), "mine")


def test_figures_that_were_improved_are_found(board: Path) -> None:
    path = board / "mine.json"
    data = json.loads(path.read_text())
    data["success"]["high_level"]["mean"] = 99.0
    path.write_text(json.dumps(data))
    with pytest.raises(DatasetError, match="another success"):
        check_submission(board, "mine")


def won(row: dict[str, Any]) -> None:
    row.update(success=True, progress=1.0)


def told_otherwise(row: dict[str, Any]) -> None:
    row["instruction"] = "Do what you like"


def of_another_benchmark(row: dict[str, Any]) -> None:
    row["benchmark"] = "v0"


def of_another_protocol(row: dict[str, Any]) -> None:
    row["protocol"] = 1


def not_gone_on(row: dict[str, Any]) -> None:
    row["lenient"] = None


def begun_elsewhere(row: dict[str, Any]) -> None:
    row["perturb_start"] = True


def another_again(row: dict[str, Any]) -> None:
    row["index"] = 0


@pytest.mark.parametrize(
    "change",
    [
        *(won, told_otherwise, begun_elsewhere, another_again),
        *(of_another_benchmark, of_another_protocol, not_gone_on),
    ],
)
def test_lines_that_were_changed_are_found(
    board: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    path = board / "mine.jsonl.xz"
    rows = [dict(one) for one in read_lines(path)]
    change(rows[59])
    write_packed(path, rows)
    with pytest.raises(DatasetError, match=r"mine\.json"):
        check_submission(board, "mine")


@pytest.mark.parametrize(
    "policy", [{"name": "oracle"}, {"name": "cliport+oracle"}, {"gta": True}]
)
def test_who_knows_the_truth_stands_apart(policy: dict[str, object]) -> None:
    bound = submission_of(result(lines(60), policy={**LEARNED, **policy}), **TOLD)
    board = {"mine": submission_of(result(lines()), **TOLD), "bound": bound}
    tables = [leaders(board, "high_level", truth=known) for known in (False, True)]
    assert [row[-2] for table in tables for row in table.rows] == ["53.3", "100.0"]
    page = board_page(board)
    learned, bounds = page.split("Bounds: these know the true state.", 1)
    assert "53.3" in learned
    assert "100.0 (99–100)" in bounds


def test_both_verdicts_are_asked_for() -> None:
    strict = [{**one, "lenient": None} for one in lines()]
    with pytest.raises(InvalidConfigError, match="without --protocol"):
        submission_of(result(strict, verdicts="strict"), **TOLD)


def test_damaged_lines_are_named(board: Path) -> None:
    (board / "mine.jsonl.xz").write_bytes(b"no lines")
    with pytest.raises(DatasetError, match=r"mine\.jsonl\.xz"):
        check_submission(board, "mine")


@pytest.mark.parametrize(
    "about",
    [
        {"protocol": "6" * 64},
        {"protocol_version": 1},
        {"benchmark": "v0"},
        {"split": "val"},
        {"language": "none"},
        {"perturb_start": True},
    ],
)
def test_only_the_plain_test_split_gets_in(about: dict[str, object]) -> None:
    with pytest.raises(InvalidConfigError, match="leaderboard"):
        submission_of(result(lines(), **about), **TOLD)


def test_only_whole_results_get_in() -> None:
    with pytest.raises(InvalidConfigError, match="59 of the 60"):
        submission_of(result(lines()[:-1]), **TOLD)


def test_the_best_comes_first(board: Path) -> None:
    mine = read_board(board)["mine"]
    better = replace(submission_of(result(lines(40)), **TOLD), title="Better")
    board_of_two = {"mine": mine, "better": better}
    table = leaders(board_of_two, "high_level", truth=False)
    assert [line[0].split("]")[0] for line in table.rows] == ["[Better", "[Mine"]


def test_what_answers_motor_commands_says_so() -> None:
    told = result(lines(), policy={**LEARNED, "level": "control"})
    entry = submission_of(told, **TOLD)
    [row] = leaders({"mine": entry}, "high_level", truth=False).rows
    assert row[0] == "[Mine](https://example.org), control level"
