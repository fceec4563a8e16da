"""Folders and results that tests share, made once for all processes and runs.

They are kept in ``.test_cache``, which git ignores and ``make clean`` removes, under a
hash of the package, of what makes them and of the versions that they depend on.
"""

import hashlib
import os
import pickle
import platform
import shutil
from collections.abc import Callable
from functools import cache, wraps
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from filelock import FileLock

import lemma
from lemma.dataset.recipe.files import REVISION_VARIABLE

HOME = Path(__file__).parents[2] / ".test_cache"
GENERATIONS = 3
"""States of the package whose fixtures are kept; older ones go."""

# Somebody may commit while the tests run; files name the revision they come from.
os.environ[REVISION_VARIABLE] = "of-the-tests"

P = ParamSpec("P")
R = TypeVar("R")


@cache
def generation() -> Path:
    """Return the folder of what the present state of the package makes."""
    digest = hashlib.sha256(platform.python_version().encode())
    for line in sorted(f"{one.name}=={one.version}" for one in distributions()):
        digest.update(line.encode())
    package = Path(lemma.__file__).parent
    for folder in (package, Path(__file__).parent):
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.relative_to(folder).as_posix().encode())
                digest.update(path.read_bytes())
    home = HOME / digest.hexdigest()[:16]
    home.mkdir(parents=True, exist_ok=True)
    os.utime(home)
    with FileLock(HOME / "lock"):
        for old in sorted(
            (path for path in HOME.iterdir() if path.is_dir()),
            key=lambda path: path.stat().st_mtime,
            reverse=True,
        )[GENERATIONS:]:
            shutil.rmtree(old, ignore_errors=True)
    return home


def kept_folder(name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that some process made; nobody may write there.

    Args:
        name: Of the folder.
        make: Fills a new folder.
    """
    folder = generation() / name
    if not folder.is_dir():
        with FileLock(generation() / f"{name}.lock"):
            if not folder.is_dir():
                begun = folder.with_name(f"{name}.begun")
                shutil.rmtree(begun, ignore_errors=True)
                make(begun)
                begun.rename(folder)
    return folder


def kept(function: Callable[P, R]) -> Callable[P, R]:
    """Keep what a function returns; its arguments are strings, its result is pickled.

    Tests of one process get the same object.
    """

    @cache
    def once(*arguments: Any) -> R:
        name = "-".join((function.__qualname__, *arguments))

        def make(folder: Path) -> None:
            folder.mkdir()
            result: Any = function(*arguments)  # type: ignore[call-arg]
            (folder / "result").write_bytes(pickle.dumps(result))

        return pickle.loads((kept_folder(name, make) / "result").read_bytes())

    @wraps(function)
    def call(*arguments: P.args, **_: P.kwargs) -> R:
        return once(*arguments)

    return call
