"""Kernels are compiled once, and again when anything that goes into them changes."""

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import lemma
from lemma.core import kernels

PACKAGE = Path(lemma.__file__).parent
_MARK = "from lemma.core.kernels import kernel"

_INNER = f"""
{_MARK}
from lemma.robots.numbers import OFFSET

@kernel
def inner(x: float) -> float:
    return 2.0 * x + OFFSET
"""
_OUTER = f"""
{_MARK}
from lemma.robots.inner import inner

@kernel
def outer(x: float) -> float:
    return inner(x) + 1.0
"""
_CALL = """
import json
from lemma.robots.outer import outer
print(json.dumps({"value": outer(3.0), "compiled": sum(
    outer.stats.cache_misses.values())}))
"""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A package with the real decorator, and a kernel that inlines another file's."""
    package = tmp_path / "lemma"
    shutil.copytree(
        PACKAGE / "core", package / "core", ignore=shutil.ignore_patterns("__pycache__")
    )
    robots = package / "robots"
    robots.mkdir()
    (package / "__init__.py").touch()
    (robots / "__init__.py").touch()
    (robots / "numbers.py").write_text("OFFSET = 0.5\n")
    (robots / "inner.py").write_text(_INNER)
    (robots / "outer.py").write_text(_OUTER)
    return package


def _start(package: Path) -> subprocess.Popen[str]:
    environment = {
        name: value for name, value in os.environ.items() if "NUMBA" not in name
    }
    environment |= {"PYTHONPATH": str(package.parent), "TMPDIR": str(package.parent)}
    return subprocess.Popen(
        [sys.executable, "-c", _CALL],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _end(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    found: dict[str, Any] = json.loads(out)
    return found | {"said": err.count("Compiling the numerical kernels")}


@pytest.mark.slow
def test_code_is_kept_until_a_file_changes_that_goes_into_it(copied: Path) -> None:
    said = copied.parent.glob("*.said")
    # Of two processes that start together, one compiles and says so.
    started = [_start(copied) for _ in range(2)]
    found = sorted(map(_end, started), key=lambda told: told["compiled"])
    assert found == [
        {"value": 7.5, "compiled": count, "said": count} for count in (0, 1)
    ]
    kept = sorted(path.name for path in copied.rglob("*.nb?"))

    (copied / "robots" / "inner.py").write_text(_INNER.replace("2.0", "4.0"))
    next(said).unlink()
    assert _end(_start(copied)) == {"value": 13.5, "compiled": 1, "said": 1}
    (copied / "robots" / "numbers.py").write_text("OFFSET = 0.25\n")
    # A kernel that has moved within its file leaves nothing behind.
    (copied / "robots" / "outer.py").write_text(f"# A comment.\n{_OUTER}")
    last = _end(_start(copied))
    assert (last["value"], last["compiled"]) == (13.25, 1)
    assert sorted(path.name for path in copied.rglob("*.nb?")) == kept


@pytest.mark.slow
def test_without_a_folder_for_temporary_files_nothing_is_left_anywhere(
    copied: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    here = tmp_path_factory.mktemp("current")
    # As on a read-only file system: the current folder is all that can be written to.
    code = (
        "import tempfile\n"
        "tempfile.tempdir = None\n"
        "tempfile._candidate_tempdir_list = lambda: FOLDERS\n"
    )
    for folders in ([str(here)], []):
        script = f"FOLDERS = {folders}\n{code}{_CALL}"
        done = subprocess.run(
            [sys.executable, "-c", script],
            cwd=here,
            env=os.environ | {"PYTHONPATH": str(copied.parent)},
            capture_output=True,
            text=True,
            check=True,
        )
        assert json.loads(done.stdout)["value"] == 7.5
        assert list(here.iterdir()) == []


def _kernel_files() -> list[Path]:
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if _MARK in path.read_text(encoding="utf-8")
    ]


def _imported_from(tree: ast.Module) -> dict[str, str]:
    return {
        alias.asname or alias.name: node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
        if node.module.startswith("lemma.")
    }


@pytest.mark.parametrize("path", _kernel_files(), ids=lambda path: path.stem)
def test_kernels_take_in_only_what_their_stamp_depends_on(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = _imported_from(tree)
    functions = [
        node
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and any("kernel" in ast.unparse(mark) for mark in node.decorator_list)
    ]
    assert functions
    for function in functions:
        inside = ast.walk(ast.Module(function.body, []))
        names = {node.id for node in inside if isinstance(node, ast.Name)}
        for name in names & imported.keys():
            folder = imported[name].removeprefix("lemma.").replace(".", "/")
            assert folder.startswith(kernels.SOURCES), (path, function.name, name)


def test_no_kernel_is_compiled_behind_the_decorators_back() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path != Path(kernels.__file__):
            assert "import njit" not in path.read_text(encoding="utf-8"), path
