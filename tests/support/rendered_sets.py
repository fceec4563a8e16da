"""A small recipe and what is rendered from it, made once for several tests."""

import atexit
from functools import cache
from pathlib import Path
from shutil import copytree, rmtree
from tempfile import mkdtemp

from lemma.core.workers.serial import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.recipe.reader import Recipe, load
from lemma.dataset.rendered.keyframes.capture import KeyframeForm
from lemma.dataset.rendered.render import RenderConfig, render

TASKS = ("pass", "stack")
SPLIT = "val"
EPISODES = 2


@cache
def scratch() -> Path:
    """Return a folder that goes when the tests are over."""
    folder = Path(mkdtemp(prefix="lemma-rendered-"))
    atexit.register(rmtree, folder, ignore_errors=True)
    return folder


@cache
def recipe_folder() -> Path:
    """Return a recipe of two tasks with two episodes each."""
    folder = scratch() / "recipe"
    generate(
        GenerateConfig(out=folder, tasks=TASKS, splits=(SPLIT,), episodes=EPISODES),
        Serial(),
    )
    return folder


def recipe() -> Recipe:
    """Return that recipe."""
    return load(recipe_folder())


@cache
def keyframes_folder() -> Path:
    """Return all keyframes of it, at the usual size; do not write there."""
    folder = scratch() / "keyframes"
    render(RenderConfig(recipe=recipe_folder(), out=folder), KeyframeForm(), Serial())
    return folder


def own_copy(folder: Path, to: Path) -> Path:
    """Copy a folder, to be damaged."""
    copytree(folder, to)
    return to


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file in a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
