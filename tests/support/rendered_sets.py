"""A small recipe and what is rendered from it, made once for several tests."""

from pathlib import Path

from kept import kept_folder

from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.files import Recipe, load
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.render import RenderConfig, render

TASKS = ("pass", "stack")
SPLIT = "val"
EPISODES = 2


def recipe_folder() -> Path:
    """Return a recipe of two tasks with two episodes each."""

    def make(out: Path) -> None:
        order = GenerateConfig(out=out, tasks=TASKS, splits=(SPLIT,), episodes=EPISODES)
        generate(order, Serial())

    return kept_folder("rendered_recipe", make)


def recipe() -> Recipe:
    """Return that recipe."""
    return load(recipe_folder())


def keyframes_folder() -> Path:
    """Return all keyframes of it, at the usual size; do not write there."""

    def make(out: Path) -> None:
        render(RenderConfig(recipe=recipe_folder(), out=out), KeyframeForm(), Serial())

    return kept_folder("keyframes", make)
