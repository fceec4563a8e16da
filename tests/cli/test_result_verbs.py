"""The verbs between results and tables."""

from pathlib import Path

import pytest
from command import run


def test_rows_without_weights_are_skipped_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    assert run("reproduce", "ablations", "--out", tmp_path, "--weights", tmp_path) == 1
    captured = capsys.readouterr()
    assert "Skipped no-palette" in captured.err
    assert "lemma train reachnet" in captured.err
    assert "Nothing was evaluated." in captured.err
    assert "results: 0." in captured.out
    assert "not run" in (tmp_path / "results.md").read_text()


def test_commands_are_printed_and_nothing_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert run("reproduce", "m-cliport", "--print", "--out", out) == 0
    lines = capsys.readouterr().out.splitlines()
    # How published weights were made stands there too, where a time limit ended it.
    lines = [line for line in lines if not line.startswith("# ")]
    assert len(lines) == 4 + 6
    assert lines[0] == "lemma generate --out data/lemma-v3"
    assert lines[-1] == "lemma reproduce m-cliport --weights runs/seed-2"
    assert not out.exists()


def test_one_evaluation_is_reported_and_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = tmp_path / "one"
    asked = ("--tasks", "stack", "--episodes", 1, "--workers", 1)
    assert run("evaluate", "--policy", "oracle", "--out", one, *asked) == 0
    assert run("report", one, "--out", tmp_path / "report") == 0
    text = (tmp_path / "report" / "results.md").read_text()
    assert "| the expert | 100.0 (21–100) | 100.0 (21–100) † |" in text
    assert run("compare", one, one) == 0
    assert "1.0000" in capsys.readouterr().out
