"""Every example runs, silently apart from what it prints, and does what it says."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lemma.core.kernels import NOTICE

EXAMPLES = Path(__file__).parents[1] / "examples"

CASES = {
    "00_first_scene.py": "depth from",
    "01_gymnasium.py": "four at once: (4, 14)",
    "02_expert.py": "success",
    "03_write_a_task.py": "success",
    "04_policy_server.py": "shared: success\nsuccess",
    "05_write_an_object.py": "success",
    "06_write_a_primitive.py": "push green_cube -> shared: success",
    "07_write_a_robot.py": "(ur5+ur16e)\nsuccess",
    "08_write_an_attack.py": "not solved",
    "09_learn_a_sub_goal.py": "2048 steps: reached",
}
SHORT = {"09_learn_a_sub_goal.py": ("2048",)}
"""What makes an example that takes minutes short."""
RENDERS = ("00", "04")


def run(name: str, *arguments: str) -> str:
    return python("-W", "error", str(EXAMPLES / name), *arguments)


def python(*words: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env=os.environ | variables,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.replace(NOTICE, "") == ""
    return done.stdout


def test_every_example_is_run_here() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(CASES)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.render if name[:2] in RENDERS else ())
        for name in CASES
    ],
)
def test_example_runs(name: str) -> None:
    assert CASES[name] in run(name, *SHORT.get(name, ()))


@pytest.mark.render
def test_the_notebook_runs_from_top_to_bottom() -> None:
    notebook = json.loads((EXAMPLES / "first_steps.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    # Nothing that was printed is kept: it would be out of date.
    assert not any(cell["outputs"] for cell in cells)
    code = "\n".join("".join(cell["source"]) for cell in cells)
    printed = python("-c", code, MPLBACKEND="Agg")
    assert "success: True" in printed
    assert "| pass |" in printed
    assert "'event': 'grasped'" in printed


@pytest.mark.render
def test_first_scene_writes_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "scene.png"
    run("00_first_scene.py", str(picture))
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize("seed", ["1", "2", "3"])
def test_expert_solves_the_ninth_task(seed: str) -> None:
    assert "success" in run("03_write_a_task.py", seed)
