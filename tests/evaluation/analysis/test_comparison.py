"""Comparisons: right figures, and only of what can be compared."""

import json
from pathlib import Path
from typing import Any

import pytest
from made_up import ABOUT, row

from lemma.cli.compare import compare as verb
from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.comparison import compare, mcnemar_p, paired_interval


def written(folder: Path, successes: set[int], **about: Any) -> Path:
    folder.mkdir()
    rows = [row("stack", i, success=i in successes) for i in range(10)]
    lines = "".join(json.dumps(one) + "\n" for one in rows)
    (folder / "episodes.jsonl").write_text(lines)
    (folder / "about.json").write_text(json.dumps({**ABOUT, **about}))
    return folder


def test_pairs_are_counted(tmp_path: Path) -> None:
    first = written(tmp_path / "a", set(range(8)))
    second = written(tmp_path / "b", {0, 1, 9})
    one = compare(first, second).by_kind["high_level"]["stack"]
    assert (one.both, one.only_first, one.only_second, one.neither) == (2, 6, 1, 1)
    assert one.success_rates == (0.8, 0.3)
    assert one.difference == pytest.approx(0.5)
    # Two-sided: 2 (1 + 7) / 2^7.
    assert one.p_value == pytest.approx(0.125)
    back = compare(second, first).by_kind["high_level"]["all"]
    assert back.difference == pytest.approx(-0.5)
    assert back.interval == pytest.approx([-limit for limit in one.interval[::-1]])


@pytest.mark.parametrize(
    ("only_first", "only_second", "p"),
    [(0, 0, 1.0), (5, 0, 0.0625), (1, 1, 1.0), (10, 2, 0.03857)],
)
def test_mcnemar(only_first: int, only_second: int, p: float) -> None:
    assert mcnemar_p(only_first, only_second) == pytest.approx(p, abs=1e-5)


# The first is an example of Newcombe 1998 (method 10); in the others only one limit of
# one Wilson interval is left.
@pytest.mark.parametrize(
    ("counts", "low", "high"),
    [
        ((36, 12, 2, 0), 0.0569, 0.3404),
        ((30, 0, 0, 0), -0.1135, 0.1135),
        ((0, 0, 0, 60), -0.0602, 0.0602),
    ],
)
def test_paired_interval(
    counts: tuple[int, int, int, int], low: float, high: float
) -> None:
    assert paired_interval(*counts) == pytest.approx((low, high), abs=1e-4)


@pytest.mark.parametrize(
    ("name", "value"),
    [("split", "other"), ("lemma", "other"), ("protocol", "other"), ("protocol", 7)],
)
def test_other_worlds_are_refused(tmp_path: Path, name: str, value: object) -> None:
    first = written(tmp_path / "a", {1})
    second = written(tmp_path / "b", {1}, **{name: value})
    with pytest.raises(DatasetError, match=name):
        compare(first, second)


def test_what_only_one_has_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = written(tmp_path / "a", {1}), written(tmp_path / "b", {1, 9})
    lines = (second / "episodes.jsonl").read_text().splitlines(keepends=True)
    (second / "episodes.jsonl").write_text("".join(lines[:-2]))
    found = compare(first, second)
    assert (found.common, found.unpaired) == (8, (2, 0))
    assert found.by_kind["high_level"]["all"].success_rates == (0.125, 0.125)
    assert verb(second, first) == 0
    assert "has 0 others, the second 2." in capsys.readouterr().err
    (second / "episodes.jsonl").write_text(
        json.dumps(row("stack", 3, success=True)) + "\n"
    )
    (first / "episodes.jsonl").write_text(lines[5])
    with pytest.raises(DatasetError, match="no episode in common"):
        compare(first, second)


def test_the_verb_prints_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = written(tmp_path / "a", {1, 2}), written(tmp_path / "b", {1})
    assert verb(first, second) == 0
    assert "+10.0" in capsys.readouterr().out
    assert verb(first, second, as_json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["high_level"]["stack"]["only_first"] == 1


def test_the_lenient_verdicts_are_compared_too(tmp_path: Path) -> None:
    first, second = written(tmp_path / "a", {1, 2}), written(tmp_path / "b", {1})
    found = compare(first, second).by_kind["high_level"]
    assert found["lenient"] == found["all"]
    path = second / "episodes.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows[5]["lenient"] |= {"success": True, "progress": 1.0, "failure": None}
    path.write_text("".join(json.dumps(one) + "\n" for one in rows))
    found = compare(first, second).by_kind["high_level"]
    assert found["lenient"].success_rates == (0.2, 0.2)
    assert found["all"].success_rates == (0.2, 0.1)
    path.write_text("".join(json.dumps({**r, "lenient": None}) + "\n" for r in rows))
    assert list(compare(first, second).by_kind["high_level"]) == ["all", "stack"]
