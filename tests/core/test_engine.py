"""With a broken MUJOCO_GL all works but pictures, and the doctor says what is wrong."""

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from ctypes.util import find_library
from pathlib import Path

import pytest

from lemma.core.kernels import NOTICE

SOURCES = Path(__file__).parents[2] / "src"
ENGINE = "lemma/core/engine.py"
OSMESA = pytest.mark.skipif(
    find_library("OSMesa") is not None, reason="OSMesa works here"
)
BROKEN = [pytest.param("osmesa", marks=[OSMESA, pytest.mark.slow]), "garbage"]


def run(
    setting: str, *words: str, cache: Path | None = None
) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "MUJOCO_GL": setting}
    environment.pop("PYOPENGL_PLATFORM", None)
    if cache is not None:
        environment["XDG_CACHE_HOME"] = str(cache)
    return subprocess.run(
        [sys.executable, "-W", "error", *words],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("setting", BROKEN)
def test_mujoco_alone_cannot_be_imported(setting: str) -> None:
    assert run(setting, "-c", "import mujoco").returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize("setting", BROKEN)
def test_what_needs_no_picture_works(setting: str) -> None:
    done = run(
        setting,
        "-c",
        "import os\n"
        "before = dict(os.environ)\n"
        "from lemma import SUITE, Episode, load_instance\n"
        "episode = Episode(load_instance(SUITE[0], 'test', 0))\n"
        "episode.simulation.tick()\n"
        "assert dict(os.environ) == before, os.environ\n"
        "print(episode.elapsed_s > 0.0)",
    )
    assert (done.stdout, done.stderr.replace(NOTICE, "")) == ("True\n", "")


@pytest.mark.slow
@pytest.mark.parametrize("setting", BROKEN)
def test_who_asks_for_a_picture_is_told(setting: str, tmp_path: Path) -> None:
    done = run(
        setting,
        "-c",
        "import lemma\nenv = lemma.make('stack', render_mode='rgb_array')\n"
        "env.reset()\nenv.render()",
        cache=tmp_path,
    )
    assert done.returncode == 1
    assert "lemma.core.errors.RenderingError" in done.stderr
    assert f"MUJOCO_GL={setting}" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("setting", BROKEN)
def test_verbs_work_and_the_doctor_says_what_is_wrong(
    setting: str, tmp_path: Path
) -> None:
    start = "from lemma.cli.main import main; main([{}])"
    done = run(setting, "-c", start.format("'tasks', '--json'"))
    assert (done.returncode, done.stderr) == (0, "")
    assert len(json.loads(done.stdout)) == 8
    done = run(setting, "-c", start.format("'doctor', '--json'"), cache=tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    report = json.loads(done.stdout)
    bad = (check for check in report["checks"] if not check["ok"])
    failed = {c["name"]: c for c in bad if not c["name"].startswith("extra")}
    assert list(failed) == ["rendering"]
    assert f"MUJOCO_GL={setting}" in failed["rendering"]["advice"]
    assert "nset it" in failed["rendering"]["advice"]


def imported(node: ast.AST) -> Iterator[str]:
    """Yield the packages that a module imports when it runs."""
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (name.name.partition(".")[0] for name in node.names)
    if isinstance(node, ast.ImportFrom):
        yield (node.module or "").partition(".")[0]
    for child in ast.iter_child_nodes(node):
        yield from imported(child)


def test_mujoco_is_imported_in_one_place() -> None:
    direct = [
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*.py")
        if "import mujoco" in (text := path.read_text()) or "from mujoco" in text
        if "mujoco" in imported(ast.parse(text))
    ]
    assert direct == [ENGINE]
