"""The script that compares what policies do now with the committed lines."""

import copy
import sys
from pathlib import Path
from typing import Any

import pytest

import check_results
from lemma.evaluation.records import read_lines

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def line() -> Any:
    return read_lines(ROOT / "leaderboard" / "expert.jsonl.gz")[0]


def test_the_weights_that_ship_are_checked() -> None:
    spec = check_results.policy_of(ROOT / "leaderboard" / "et-cliport.jsonl.gz")
    assert spec.name == "episodic-transformer+cliport"
    assert (spec.planning, spec.gta) == ("single-step", False)


def test_what_differs_is_told(line: Any) -> None:
    assert list(check_results.differences(line, line)) == []
    now = copy.deepcopy(line)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0005
    assert list(check_results.differences(line, now)) == []
    assert check_results.largest_shift(line, now) == pytest.approx(0.0005)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0010
    now["subtasks"][0]["outcome"] = "dropped"
    now["subtasks"][1]["grounded"]["place"][2] += 0.02
    now["success"] = False
    assert list(check_results.differences(line, now)) == [
        "success was True, is False",
        "sub-task 1: outcome was success, is dropped",
        "sub-task 1: its pick moved by 1.50 mm and 0.0000 rad",
        "sub-task 2: its place moved by 0.00 mm and 0.0200 rad",
    ]
    now["subtasks"][0]["grounded"] = None
    del now["subtasks"][1]
    assert [one[:26] for one in check_results.differences(line, now)][1:] == [
        "2 sub-tasks, now 1",
        "sub-task 1: outcome was su",
        "sub-task 1: poses were {'r",
    ]


@pytest.mark.slow
def test_the_expert_does_what_its_lines_say(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [
        "check_results.py",
        "expert",
        "--episodes",
        "2",
        "--tasks",
        "stack",
        "hook",
    ]
    monkeypatch.setattr(sys, "argv", words)
    assert check_results.main() == 0
    assert "0 of 4 episodes differ; poses moved by at most 0.0000 mm" in (
        capsys.readouterr().out
    )
