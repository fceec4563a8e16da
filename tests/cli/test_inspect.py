"""`lemma inspect`: its output and pictures."""

import json
import re
from pathlib import Path
from shutil import copytree

import pytest
from command import run
from PIL import Image
from rendered_sets import recipe_folder


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of pass and two of stack."""
    return copytree(
        recipe_folder(), tmp_path_factory.mktemp("recipe") / "<small> & odd"
    )


def test_numbers_as_json(
    recipe: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("inspect", recipe, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["total"]["episodes"] == found["total"]["solved"] == 4
    assert found["tasks"]["pass"]["subtasks"]["mean"] == 2.0
    assert found["splits"]["val"]["episodes"] == 4
    assert sum(team["episodes"] for team in found["teams"].values()) == 4
    assert found["versions"]["benchmark"] == "v3"
    assert found["primitives_s"]["move"]["mean"] > 1.0
    assert list(tmp_path.iterdir()) == []


def test_one_task_alone(recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("inspect", recipe, "--task", "stack", "--split", "val", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["tasks"]) == ["stack"]
    assert found["total"]["episodes"] == 2


def test_tables_fit_a_terminal(
    recipe: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run("inspect", recipe) == 0
    text = capsys.readouterr().out
    for heading in ("episodes", "sub-tasks", "distractors", "margin"):
        assert heading in text
    assert "…" not in text
    assert re.search(r"^all +4 +100% +2\.00 ", text, re.MULTILINE)
    assert re.search(r"^sub-tasks +move \d+\.\d s$", text, re.MULTILINE)


@pytest.mark.render
def test_one_episode_as_pictures(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "episode.png"
    words = ("--task", "stack", "--split", "val", "--index", 1, "--out", out)
    assert run("inspect", recipe, *words) == 0
    text = capsys.readouterr().out
    assert "v3/stack/val/1" in text
    assert "solved after" in text
    assert "shared space" in text.replace("\n", " ")
    picture = Image.open(out).convert("RGB")
    # Three keyframes in one row.
    assert picture.width > 3 * 600
    assert picture.height < 700
    tile = picture.crop((36, 138, 36 + 620, 138 + 400))
    last = picture.crop((36 + 1280, 138, 36 + 1280 + 620, 138 + 400))
    assert len(tile.getcolors(tile.width * tile.height) or ()) > 100
    assert tile.tobytes() != last.tobytes()
