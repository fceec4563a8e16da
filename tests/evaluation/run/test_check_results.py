"""The script that compares what policies do now with the committed lines."""

import copy
import sys
from pathlib import Path
from typing import Any

import pytest
from made_up import row, step

import check_results
from lemma.core.workers.serial import Serial
from lemma.evaluation.lines import write_packed
from lemma.evaluation.run.evaluate import EvaluationConfig, evaluate
from lemma.policies.spec import PolicySpec


@pytest.fixture(scope="module")
def line() -> Any:
    poses = {
        "robot": "robot_0",
        "primitive": "move",
        "pick": [0.1, 0.2, 0.3],
        "place": [0.4, 0.5, 0.6],
    }
    steps = [{**step(), "grounded": copy.deepcopy(poses)} for _ in range(2)]
    return row(success=True, steps=steps)


def test_what_differs_is_told(line: Any) -> None:
    assert list(check_results.differences(line, line)) == []
    now = copy.deepcopy(line)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0005
    assert list(check_results.differences(line, now)) == []
    assert check_results.largest_shift(line, now) == pytest.approx(0.0005)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0010
    now["subtasks"][0]["outcome"] = "dropped"
    now["subtasks"][1]["grounded"]["place"][2] += 0.02
    now["success"] = now["lenient"]["success"] = False
    assert list(check_results.differences(line, now)) == [
        "success was True, is False",
        "leniently, success was True, is False",
        "sub-task 1: outcome was success, is dropped",
        "sub-task 1: its pick moved by 1.50 mm and 0.0000 rad",
        "sub-task 2: its place moved by 0.00 mm and 0.0200 rad",
    ]
    now["subtasks"][0]["grounded"] = None
    del now["subtasks"][1]
    assert [one[:26] for one in check_results.differences(line, now)][2:] == [
        "2 sub-tasks, now 1",
        "sub-task 1: outcome was su",
        "sub-task 1: poses were {'r",
    ]


@pytest.mark.slow
def test_the_expert_does_what_its_lines_say(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    tasks = ("stack", "hook")
    order = EvaluationConfig(
        out=tmp_path / "expert", policy=PolicySpec(), tasks=tasks, episodes=2
    )
    rows = evaluate(order, Serial())
    results = tmp_path / "results" / "oracle"
    results.mkdir(parents=True)
    # Of one episode a result says something else.
    lost = [{**rows[0], "success": False}, *rows[1:]]
    write_packed(results / "seed-0.jsonl.xz", lost)
    monkeypatch.setattr(check_results, "ROOT", tmp_path)
    # Of a task without lines nothing is compared.
    asked = ("--tasks", *tasks, "poke", "--workers", "1")
    words = ["check_results.py", "--episodes", "2", *asked]
    monkeypatch.setattr(sys, "argv", words)
    assert check_results.main() == 1
    said = capsys.readouterr().out
    assert "success was False, is True" in said
    assert "oracle: 1 of 4 episodes differ; poses moved by at most 0.0000 mm" in said


def test_what_needs_lerobot_is_left_out_where_it_is_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = {"lerobot": None}
    monkeypatch.setattr(check_results, "find_spec", there.get)
    assert not check_results.playable("act-privileged")
    assert "act-privileged: left out" in capsys.readouterr().out
    assert check_results.playable("reachnet")
    monkeypatch.setattr(check_results, "find_spec", lambda name: name)
    assert check_results.playable("act-privileged")


@pytest.mark.parametrize("names", [[], ["mine"]])
def test_a_check_of_nothing_is_none(
    names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_results, "ROOT", tmp_path)
    monkeypatch.setattr(sys, "argv", ["check_results.py", *names])
    with pytest.raises(SystemExit) as left:
        check_results.main()
    assert left.value.code == 2


def test_results_that_ship_with_lines_are_found() -> None:
    found = check_results.committed(check_results.ROOT)
    assert "reachnet" in found
    assert all(path.is_file() for path in found.values())
