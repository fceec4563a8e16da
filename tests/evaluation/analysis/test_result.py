"""Summaries: complete, the same bytes for the same episodes, and readable again."""

import json
from pathlib import Path
from typing import Any

import pytest
from made_up import ABOUT, result, row, step

from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from lemma.evaluation.analysis.result import read_result, summarise
from lemma.evaluation.lines import read_lines, write_rows
from lemma.evaluation.records import (
    EPISODES,
    SUMMARY,
    training_seed,
)
from lemma.evaluation.report.policy_results import read_results
from lemma.evaluation.run.loading import learned_parts, weights_of
from lemma.policies.spec import PolicySpec

ROWS = [
    row("stack", 0, success=True, steps=[step(2, pick_mm=2.0), step(1, place_mm=3.0)]),
    row("stack", 1, steps=[step(2, pick_mm=40.0, outcome="missed_grasp")], left=2),
    row("pass", 0, success=True, distractors=0, team="ur5+ur5"),
    row("pass", 0, instruction_kind="unseen", steps=[step(2, "robot")], left=2),
]


def test_everything_is_counted_once() -> None:
    made = summarise(ROWS, ABOUT)
    assert sum(cell.episodes for cell in made.cells) == len(ROWS)
    # In the order of kinds and tasks.
    assert [(c.kind, c.task, c.successes) for c in made.cells] == [
        ("high_level", "pass", 1),
        ("high_level", "stack", 1),
        ("unseen", "pass", 0),
    ]
    assert [(x.kind, x.task, x.cause, x.episodes) for x in made.losses] == [
        ("high_level", "stack", "missed_pick", 1),
        ("unseen", "pass", "wrong_robot", 1),
    ]
    pick, place = made.precisions
    assert (pick.end, pick.poses, pick.median_mm, pick.missed) == ("pick", 2, 21.0, 1)
    assert (place.end, place.poses, place.median_mm) == ("place", 1, 3.0)


def test_neither_order_nor_clock_shows_in_the_bytes(tmp_path: Path) -> None:
    slower = [{**one, "wall_s": 9.0} for one in reversed(ROWS)]
    summarise(ROWS, ABOUT).write(tmp_path / "a.json")
    summarise(slower, ABOUT).write(tmp_path / "b.json")
    first = (tmp_path / "a.json").read_bytes()
    assert first == (tmp_path / "b.json").read_bytes()
    summarise([{**ROWS[0], "elapsed_s": 9.0}, *ROWS[1:]], ABOUT).write(
        tmp_path / "c.json"
    )
    assert first != (tmp_path / "c.json").read_bytes()


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    made = result(3, seed=2)
    made.write(tmp_path / "seed-2.json")
    assert read_result(tmp_path / "seed-2.json") == made
    assert made.seed == 2


@pytest.mark.parametrize(
    ("old", "new"), [('"version": "3"', '"version": "2"'), ('"task"', '"tusk"')]
)
def test_other_files_are_named(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "summary.json"
    result(3).write(path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(DatasetError, match="summary"):
        read_result(path)


def test_a_policy_has_one_training_seed() -> None:
    weights = {"et": {"seed": 1}, "cliport": {"seed": 1}}
    assert training_seed(weights) == 1
    assert training_seed({}) == 0
    with pytest.raises(DatasetError, match="cliport: 2"):
        training_seed({**weights, "cliport": {"seed": 2}})


@pytest.mark.parametrize(
    ("policy", "parts"),
    [
        ("oracle", []),
        ("reachnet", ["reachnet"]),
        ("episodic-transformer+oracle", ["episodic-transformer"]),
        ("package.module:Class", []),
        ("http://127.0.0.1:8000", []),
        ("http://127.0.0.1:8000+cliport", ["cliport"]),
    ],
)
def test_only_our_own_weights_are_looked_at(policy: str, parts: list[str]) -> None:
    assert learned_parts(policy) == parts
    if not parts:
        assert weights_of(PolicySpec(policy)) == {}


def test_weights_of_lerobot_are_those_of_the_folder(tmp_path: Path) -> None:
    policy = PolicySpec(f"lerobot:{tmp_path}")
    assert weights_of(policy) == {}
    (tmp_path / "config.json").write_text('{"type": "act"}')
    training: dict[str, Any] = {"seed": 3, "dataset": {"repo_id": "you/two"}}
    write_json(tmp_path / "train_config.json", training)
    digests = set()
    for content in (b"one", b"another"):
        (tmp_path / "model.safetensors").write_bytes(content)
        about = weights_of(policy)["act"]
        assert (about["seed"], about["data"]) == (3, {"repo_id": "you/two"})
        assert "ended" not in about
        digests.add(about["sha256"])
    assert len(digests) == 2
    write_json(tmp_path / "train_config.json", {**training, "ended": "time limit"})
    assert weights_of(policy)["act"]["ended"] == "time limit"


def kept(folder: Path, rows: list[dict[str, Any]]) -> Path:
    """Write what `lemma evaluate` writes, and return the folder."""
    folder.mkdir()
    summarise(rows, ABOUT, "lemma evaluate").write(folder / SUMMARY)
    write_rows(folder / EPISODES, rows)
    return folder


def test_lines_that_fit_are_read(tmp_path: Path) -> None:
    folder = kept(tmp_path / "a", ROWS)
    # Another run into the same folder, of more.
    write_rows(folder / EPISODES, [*ROWS, row("stack", 2), row("hook", 0)])
    (result_read,) = read_results([folder])
    assert sum(cell.episodes for cell in result_read.cells) == len(ROWS)


def test_lines_that_do_not_fit_their_summary_are_found(tmp_path: Path) -> None:
    folder = kept(tmp_path / "a", ROWS)
    won = [row("stack", 1, success=True) if r is ROWS[1] else r for r in ROWS]
    write_rows(folder / EPISODES, won)
    with pytest.raises(DatasetError, match="stack: 1 of 2 in the summary, 2 of 2 in"):
        read_results([folder])
    write_rows(folder / EPISODES, ROWS[:1])
    with pytest.raises(DatasetError, match="pass: 1 of 1 in the summary, none in"):
        read_results([folder])
    # The same rates, but another episode.
    write_rows(folder / EPISODES, [{**r, "instruction": "Do it"} for r in ROWS])
    with pytest.raises(DatasetError, match="the same rates, other episodes"):
        read_results([folder / SUMMARY])


def test_lines_beside_a_file_of_a_seed_are_counted_too(tmp_path: Path) -> None:
    folder = kept(tmp_path / "seed-0", ROWS)
    (folder / SUMMARY).rename(tmp_path / "seed-0.json")
    write_rows(folder / EPISODES, [{**r, "progress": 0.25} for r in ROWS])
    with pytest.raises(DatasetError, match="does not fit the lines"):
        read_results([tmp_path])


def test_a_summary_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    folder = kept(tmp_path / "a", ROWS)
    data = json.loads((folder / SUMMARY).read_text())
    cells = data["cells"]
    strict, lenient = map(cells["columns"].index, ("successes", "lenient_successes"))
    cells["rows"][1][strict] = cells["rows"][1][lenient] = 2
    (folder / SUMMARY).write_text(json.dumps(data))
    with pytest.raises(DatasetError, match=r"0 failed .* of stack, and"):
        read_result(folder / SUMMARY)
    # More than there are; fewer leniently than strictly.
    for counts in ((3, 3), (2, 1)):
        cells["rows"][1][strict], cells["rows"][1][lenient] = counts
        (folder / SUMMARY).write_text(json.dumps(data))
        with pytest.raises(DatasetError, match="cannot be"):
            read_result(folder / SUMMARY)


def test_a_table_of_entries_that_name_each_column_is_read_too(tmp_path: Path) -> None:
    # As results were written formerly.
    path = kept(tmp_path / "a", ROWS) / SUMMARY
    data = json.loads(path.read_text())
    for name, table in data.items():
        if isinstance(table, dict) and "columns" in table:
            named = [dict(zip(table["columns"], r, strict=True)) for r in table["rows"]]
            data[name] = named
    assert data["cells"][0]["kind"] == "high_level"
    old = tmp_path / "old.json"
    old.write_text(json.dumps(data))
    assert read_result(old) == read_result(path)


@pytest.mark.parametrize(
    "table",
    [
        {"columns": ["kind"], "rows": [["high_level", 1]]},
        {"columns": ["kind"]},
        {"columns": ["kind"], "rows": [["high_level"]]},
        {"columns": 1, "rows": 2},
        [1],
        "cells",
        None,
    ],
)
def test_a_damaged_table_is_refused(tmp_path: Path, table: object) -> None:
    path = kept(tmp_path / "a", ROWS) / SUMMARY
    path.write_text(json.dumps(json.loads(path.read_text()) | {"cells": table}))
    with pytest.raises(DatasetError, match="is damaged"):
        read_result(path)


def later(index: int, **lenient: object) -> dict[str, Any]:
    """Return the line of an episode that ended by a protective stop, and went on."""
    stopped = [step(2, "robot", "unreachable", able=False)]
    line = row("stack", index, steps=stopped, left=2, failure="protective_stop")
    told = {"success": True, "progress": 1.0, "failure": None, "elapsed_s": 40.0}
    return {**line, "lenient": {**line["lenient"], **told, **lenient}}


def test_both_verdicts_are_counted() -> None:
    made = summarise([row("stack", 0, success=True), later(1), later(2)], ABOUT)
    (cell,) = made.cells
    assert (cell.episodes, cell.successes, cell.lenient_successes) == (3, 1, 3)
    (lost,) = made.losses
    assert (lost.cause, lost.episodes) == ("wrong_robot", 2)
    (found,) = made.coordination
    assert (found.stops, found.refusals) == (2, 2)
    assert (found.timed_s, found.lenient_timed_s) == (30.0, 110.0)
    assert (found.expert_s, found.lenient_expert_s) == (20.0, 60.0)


def test_a_line_says_which_protocol_it_follows(tmp_path: Path) -> None:
    path = tmp_path / EPISODES
    write_rows(path, [later(0)])
    assert read_lines(path) == [later(0)]
    write_rows(path, [{**later(0), "protocol": 1}])
    with pytest.raises(DatasetError, match="follows protocol 1"):
        read_lines(path)
    write_rows(path, [{**later(0, success=False), "success": True}])
    with pytest.raises(DatasetError, match="strictly, but not leniently"):
        read_lines(path)


DEEP = "[" * 100_000


@pytest.mark.parametrize("file", [SUMMARY, EPISODES])
@pytest.mark.parametrize(
    "text", ["", "[]", "null", "3", '"x"', "{", "\x00", DEEP, '{"version": "1"}', "NaN"]
)
def test_what_is_no_result_is_refused(tmp_path: Path, file: str, text: str) -> None:
    folder = kept(tmp_path / "a", ROWS)
    (folder / file).write_text(text + "\n")
    with pytest.raises(DatasetError):
        read_results([folder])


@pytest.mark.parametrize("file", [SUMMARY, EPISODES])
@pytest.mark.parametrize("value", [None, 3, "x", [], {}, [[]], -1, True, "1e9"])
def test_wrong_types_are_refused(tmp_path: Path, file: str, value: object) -> None:
    folder = kept(tmp_path / "a", ROWS)
    first, _, rest = (folder / file).read_text().partition("\n")
    data = json.loads(first if file == EPISODES else first + rest)
    for name in data:
        if type(data[name]) is type(value) or name == "wall_s":
            continue
        changed = json.dumps({**data, name: value})
        if (data | {name: value}) == data or name in ("left", "asked", "asked_holds"):
            continue
        (folder / file).write_text(
            f"{changed}\n{rest}" if file == EPISODES else changed
        )
        with pytest.raises(DatasetError):
            read_results([folder])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("policy", "reachnet"),
        ("policy", {"name": 1}),
        ("weights", {"reachnet": "0"}),
        ("split", "exam"),
        ("horizon_s", "long"),
        ("protocol", None),
    ],
)
def test_notes_are_checked(tmp_path: Path, name: str, value: object) -> None:
    folder = kept(tmp_path / "a", ROWS)
    data = json.loads((folder / SUMMARY).read_text())
    data["about"][name] = value
    (folder / SUMMARY).write_text(json.dumps(data))
    with pytest.raises(DatasetError):
        read_results([folder])
