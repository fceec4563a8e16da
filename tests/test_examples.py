"""Every example runs, silently apart from what it prints, and does what it says."""

import io
import json
import runpy
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from interpreter import python
from own_plugins import EXAMPLES, loaded

from lemma.core.kernels import NOTICE
from lemma.policies.models.base import MODELS

# A text that each example prints, and arguments that make it short.
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "00_first_scene.py": ("depth from", ()),
    "01_gymnasium.py": ("four at once: (4, 14)", ()),
    "02_expert.py": ("success", ()),
    "03_data.py": ("exact: True\n6 keyframes", ("DATA",)),
    "04_train_a_model.py": ("WhoIsNext of step 2: {'robot': 0.", ("DATA", "2")),
    "05_evaluate_a_policy.py": ("| mean, lenient | 100.0 |", ("2",)),
    "06_control_loop.py": ("lifted the pink_cube by 15 cm", ()),
    "07_browser.py": ("success\nDone\n", ("18095", "--once")),
    "08_policy_server.py": ("shared: success\nsuccess", ()),
    "09_learn_by_reward.py": ("% begin near", ("lift_fixed", "512", "0")),
    "10_write_a_task.py": ("success", ()),
    "11_write_an_object.py": ("success", ()),
    "12_write_a_primitive.py": ("push blue_cube -> shared: success", ()),
    "13_write_a_robot.py": ("(ur5+ur16e)\nsuccess", ()),
    "14_write_an_attack.py": ("not solved", ()),
    "15_act_together.py": ("success after 2", ()),
}
RENDERS = ("00", "03", "04", "06", "08")
LONG = ("03", "04", "06", "09", "15")
"""Data, training, motor commands and teams have quick tests of their own."""
REPORTS_PROGRESS = ("04_train_a_model.py",)
"""On the error stream."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where one example writes what the next one reads."""
    return tmp_path_factory.mktemp("first-data")


def run(name: str, *arguments: str) -> str:
    """Run an example as ``python`` would, warnings as errors; return what it printed.

    In this process, because imports take longer than what most examples do.
    """
    code: object = 0
    with (
        pytest.MonkeyPatch.context() as patch,
        loaded(),
        redirect_stdout(io.StringIO()) as out,
        redirect_stderr(io.StringIO()) as err,
    ):
        patch.setattr(sys, "argv", [name, *arguments])
        for field in ("_records", "_added_by"):
            patch.setattr(MODELS, field, dict(getattr(MODELS, field)))
        try:
            runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        except SystemExit as end:
            code = end.code
    assert not code, out.getvalue()
    if name not in REPORTS_PROGRESS:
        assert err.getvalue().replace(NOTICE, "") == ""
    return out.getvalue()


def told_by(*words: str, **variables: str) -> str:
    done = python(*words, variables=variables)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.replace(NOTICE, "") == ""
    return done.stdout


def test_every_example_is_run_here() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(CASES)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=[
                *([pytest.mark.render] if name[:2] in RENDERS else []),
                *([pytest.mark.slow] if name[:2] in LONG else []),
            ],
        )
        for name in CASES
    ],
)
def test_example_runs(name: str, data: Path) -> None:
    told, short = CASES[name]
    if name[:2] == "04" and not (data / "keyframes").exists():
        run("03_data.py", str(data))
    assert told in run(name, *(str(data) if w == "DATA" else w for w in short))


@pytest.mark.slow
def test_an_example_runs_by_itself() -> None:
    assert "success" in told_by("-W", "error", str(EXAMPLES / "02_expert.py"))


@pytest.mark.slow
@pytest.mark.render
def test_the_notebook_runs_from_top_to_bottom() -> None:
    notebook = json.loads((EXAMPLES / "first_steps.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    # Nothing that was printed is kept: it would be out of date.
    assert not any(cell["outputs"] for cell in cells)
    code = "\n".join("".join(cell["source"]) for cell in cells)
    printed = told_by("-c", code, MPLBACKEND="Agg")
    assert "success: True" in printed
    assert "| pass |" in printed
    assert "'event': 'grasped'" in printed


@pytest.mark.render
def test_first_scene_writes_a_picture(tmp_path: Path) -> None:
    picture = tmp_path / "scene.png"
    run("00_first_scene.py", str(picture))
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("seed", ["1", "2", "3"])
def test_expert_solves_the_ninth_task(seed: str) -> None:
    assert "success" in run("10_write_a_task.py", seed)


def test_the_lines_of_the_readme_evaluate_a_policy() -> None:
    page = (EXAMPLES.parent / "README.md").read_text()
    part = page.split("## Your policy, in fifteen lines")[1]
    code = part.split("```python\n")[1].split("```")[0]
    assert len([line for line in code.splitlines() if line]) <= 15
    with redirect_stdout(io.StringIO()) as out:
        exec(code.replace("episodes=10", "episodes=2"), {"__name__": "__main__"})
    assert "| mean, lenient | 100.0 |" in out.getvalue()
