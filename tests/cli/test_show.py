"""Instances by name and from files: `lemma show`, and what other verbs do with them."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import run as lemma
from PIL import Image
from tiers import slow_but

from lemma.tasks.suite import load_instance
from lemma.viz.sheets import SHEET_HEIGHT_PX, SHEET_WIDTH_PX, depth_picture


@pytest.mark.render
def test_show_writes_one_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "new" / "hook.png"
    assert lemma("show", "hook", "--index", 3, "--out", path) == 0
    text = capsys.readouterr().out
    assert str(path) in text
    assert "high_level" in text
    assert "relational Put the" in text
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert picture.size == (SHEET_WIDTH_PX, SHEET_HEIGHT_PX)
        pixels = np.asarray(picture).reshape(-1, 3) @ (1 << 16, 1 << 8, 1)
    # Cameras, depth and map bring many colors; a blank sheet would have few.
    assert len(np.unique(pixels)) > 2000


@pytest.mark.parametrize("name", ["picture", "picture.xyz", "", "file/x.png"])
def test_name_that_is_no_picture_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert lemma("show", "pass", "--out", tmp_path / name) == 2
    assert re.search("picture|is a file", capsys.readouterr().err)


def test_demo_needs_a_folder_for_its_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert lemma("demo", "pass", "--out", tmp_path / "file") == 2
    assert "file cannot be used: File exists." in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("robots", slow_but([1, 2], 1))
def test_table_with_one_robot_or_one_sentence_is_shown(
    robots: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = load_instance("stack", "test", 0).to_dict()
    data["robots"] = data["robots"][:robots]
    data["instructions"] = {"human": "Stack [them]"}
    own = tmp_path / "own.json"
    own.write_text(json.dumps(data))
    path = tmp_path / "[draft].png"
    assert lemma("show", "--instance", own, "--out", path) == 0
    told = capsys.readouterr().out
    assert "Stack [them]" in told
    assert ("this one has 1" in told) == (robots == 1)
    assert str(path) in told
    assert path.exists()


def test_near_is_bright_and_nothing_is_black() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    depth[:24] = 1.0
    depth[:, :8] = 0.0
    picture = np.asarray(depth_picture(depth, 1.0, 2.0)).astype(int)
    near, far = picture[10, 40].sum(), picture[36, 40].sum()
    assert near > 2 * far > 0
    assert picture[10, 2].sum() == 0


# --- Instances of one's own, with --instance ----------------------------------------

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
            "the only episode",
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
