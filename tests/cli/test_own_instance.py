"""``--instance FILE.json``: every verb that takes an instance takes one of your own."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from command import run as lemma

from lemma.tasks.suite import load_instance

STACK = load_instance("stack", "test", 0)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    objects = tuple(
        replace(placed, pose=replace(placed.pose, yaw=0.1))
        for placed in STACK.scene.objects
    )
    changed = replace(STACK, scene=replace(STACK.scene, objects=objects))
    path = tmp_path / "own.json"
    path.write_text(changed.to_json())
    return path


def test_demo_plays_it(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert lemma("demo", "--instance", own, "--no-video", "--json") == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["success"]


def test_evaluation_plays_it_alone_and_keeps_it(own: Path, tmp_path: Path) -> None:
    out = tmp_path / "result"
    words = ("evaluate", "--policy", "oracle", "--out", out, "--instance", own)
    assert lemma(*words) == 0
    (row,) = map(json.loads, (out / "episodes.jsonl").read_text().splitlines())
    assert row["split"] == "own"
    assert row["success"]
    kept = json.loads((out / "about.json").read_text())["instance"]
    assert kept == {**json.loads(own.read_text()), "split": "own"}
    # Of another instance, that folder has nothing to say.
    own.write_text(STACK.to_json())
    assert lemma(*words) != 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("demo", "pass"), "is an instance of stack"),
        (("show", "--index", "2"), "without --split"),
        (
            ("evaluate", "--policy", "oracle", "--out", "x", "--episodes", "2"),
            "alone|all",
        ),
        (("play", "--index", "1", "--no-open"), "without --split"),
    ],
)
def test_it_stands_alone(
    own: Path, words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lemma(*words, "--instance", own) == 2
    assert re.search(says, capsys.readouterr().err)


@pytest.mark.parametrize("text", ["", "{}", '{"a": 1}', json.dumps({"version": "v1"})])
@pytest.mark.parametrize("verb", ["show", "demo", "play"])
def test_file_that_holds_no_instance_is_refused(
    verb: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    assert lemma(verb, "--instance", path) == 2
    assert "bad.json" in capsys.readouterr().err


def test_show_needs_a_task_or_a_file() -> None:
    assert lemma("show") == 2
