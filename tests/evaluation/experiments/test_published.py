"""Policies compared with published lines: what differs is said, within a tolerance."""

import copy
import json
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from made_up import row, step

from lemma.bench import evaluation_checks
from lemma.cli.main import main
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.experiments.catalog import EXPERIMENTS
from lemma.evaluation.experiments.published import compared, published_sample
from lemma.evaluation.lines import packed_beside, read_lines, write_packed
from lemma.evaluation.records import key_of

RESULTS = Path(__file__).parents[3] / "results"


def test_what_differs_is_told() -> None:
    poses = {
        "robot": "robot_0",
        "primitive": "move",
        "pick": [0.1, 0.2, 0.3],
        "place": [0.4, 0.5, 0.6],
    }
    steps = [{**step(), "grounded": copy.deepcopy(poses)} for _ in range(2)]
    line: Any = row(success=True, steps=steps)
    assert compared([(line, line)]).ok
    now = copy.deepcopy(line)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0005
    near = compared([(line, now)])
    assert near.ok
    assert near.farthest_m == pytest.approx(0.0005)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0010
    now["subtasks"][0]["outcome"] = "dropped"
    now["subtasks"][1]["grounded"]["place"][2] += 0.02
    now["success"] = now["lenient"]["success"] = False
    (told,) = compared([(line, now)]).differing
    assert told.partition(": ")[2].split("; ") == [
        "success was True, is False",
        "leniently, success was True, is False",
        "sub-task 1: outcome was success, is dropped",
        "sub-task 1: its pick moved by 1.50 mm and 0.0000 rad",
        "sub-task 2: its place moved by 0.00 mm and 0.0200 rad",
    ]
    now["subtasks"][0]["grounded"] = None
    del now["subtasks"][1]
    (told,) = compared([(line, now)]).differing
    assert "2 sub-tasks, now 1" in told
    assert "sub-task 1: poses were {'robot'" in told
    with pytest.raises(InvalidConfigError, match="No episode"):
        compared([])


def test_the_sample_in_the_package_is_of_published_lines() -> None:
    for name in ("oracle", "reachnet"):
        path = packed_beside(EXPERIMENTS[name].summary_path(RESULTS, 0))
        lines = {key_of(row): row for row in read_lines(path)}
        for line in published_sample()[name]:
            assert line == lines[key_of(line)]


@pytest.mark.slow
def test_reproduce_says_whether_policies_decide_as_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = packed_beside(EXPERIMENTS["oracle"].summary_path(RESULTS, 0))
    lines = [dict(r) for r in read_lines(path) if r["task"] in ("stack", "hook")]
    lines = [r for r in lines if r["instruction_kind"] == "human"]
    kept = packed_beside(EXPERIMENTS["oracle"].summary_path(tmp_path, 0))
    kept.parent.mkdir()
    for success, code in ((True, 0), (False, 1)):
        # One of them says something else.
        lines[0]["success"] = success
        write_packed(kept, lines)
        with pytest.raises(SystemExit) as left:
            main(["reproduce", "oracle", "--check", "--out", str(tmp_path)])
        assert left.value.code == code
        told = capsys.readouterr().out
        assert f"oracle: {2 - code} of 2 episodes are equal" in told


@pytest.mark.slow
@pytest.mark.render
def test_the_doctor_plays_a_sample_of_each_level(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["doctor", "--evaluation", "--json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    found = {check["name"]: check for check in checks}
    for name in ("protocol", "published decisions", "control level: the expert"):
        assert found[name]["ok"], found[name]
    assert found["plan and poses: reachnet"]["ok"]


def test_what_differs_from_published_lines_is_no_ok(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (line,) = published_sample()["oracle"]
    changed = {**line, "elapsed_s": 1.0}
    monkeypatch.setattr(
        evaluation_checks,
        "published_sample",
        lambda: {"reachnet": [changed], "oracle": []},
    )
    # All that needs no network.
    found = {one.name: one for one in islice(evaluation_checks.check_evaluation(), 4)}
    assert not found["published decisions"].ok
    assert "elapsed_s is 1.0, and" in found["published decisions"].found
    # Nothing to compare is no agreement.
    assert not found["skill level: the expert"].ok
    assert found["actions, normalised and back"].ok
