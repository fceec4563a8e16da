"""The package that a wheel installs works, and is small."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LARGEST_WHEEL = 15e6
LARGEST_TREE = 90e6
_WITHOUT_CHECKOUT = ("PYTHONPATH", "LEMMA_WEIGHTS", "LEMMA_REVISION")


def run(*words: str | Path, folder: Path) -> str:
    """Run a command outside the checkout; return what it printed."""
    variables = {n: v for n, v in os.environ.items() if n not in _WITHOUT_CHECKOUT}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder, env=variables, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


def test_the_working_tree_is_light() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode:
        pytest.skip("this is no git checkout")
    files = [ROOT / os.fsdecode(name) for name in listed.stdout.split(b"\0") if name]
    assert sum(path.stat().st_size for path in files if path.exists()) < LARGEST_TREE


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of this checkout, made from its source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "-o", folder, ROOT,
        folder=folder)  # fmt: skip
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts of an environment with the wheel, and packages of this one."""
    folder = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", folder=folder)
    python = folder / "venv" / "bin" / "python"
    here = sysconfig.get_path("purelib")
    there = Path(
        run(
            python,
            "-c",
            "import sysconfig; print(sysconfig.get_path('purelib'))",
            folder=folder,
        ).strip()
    )
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps",
        "--no-index", wheel, folder=folder)  # fmt: skip
    # A line of a .pth file comes behind what is installed here, and runs no .pth files
    # of the other environment: its editable checkout is not seen.
    (there / "dependencies.pth").write_text(f"{here}\n")
    keep_compiled_kernels(there / "lemma")
    return python.parent


def keep_compiled_kernels(package: Path) -> None:
    """Give an installed package what was compiled of the same sources here.

    It is stamped with a hash of them: what was made of others is not taken.
    """
    for kept in (ROOT / "src/lemma").rglob("*.nb[ic]"):
        copy = package / kept.relative_to(ROOT / "src/lemma")
        copy.parent.mkdir(exist_ok=True)
        shutil.copy(kept, copy)


@pytest.mark.slow
def test_a_wheel_is_small_and_has_no_weights(wheel: Path) -> None:
    assert wheel.stat().st_size < LARGEST_WHEEL
    names = zipfile.ZipFile(wheel).namelist()
    assert not [name for name in names if name.endswith((".safetensors", ".pt"))]
    assert "lemma/policies/weights.json" in names
    assert not [name for name in names if not name.startswith("lemma")]


@pytest.mark.slow
@pytest.mark.render
def test_an_installed_wheel_plays_an_episode(environment: Path, tmp_path: Path) -> None:
    where = run(environment / "python", "-c", "import lemma; print(lemma.__file__)",
                folder=tmp_path)  # fmt: skip
    assert Path(where.strip()).is_relative_to(environment.parent)
    lemma = environment / "lemma"
    assert "hook_stack" in run(lemma, "tasks", folder=tmp_path)
    assert run(lemma, "doctor", folder=tmp_path)
    out = run(lemma, "demo", "pass", "--no-video", folder=tmp_path)
    assert "move" in out
    code = "from lemma.policies.weights import find_weights; find_weights('reachnet')"
    told = subprocess.run(
        [environment / "python", "-c", code],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path)},
    )  # fmt: skip
    assert told.returncode
    assert "LEMMA_WEIGHTS=FOLDER" in told.stderr
