"""A small recipe of perturbed executions, made once for several tests."""

import atexit
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

from lemma.core.workers.serial import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.recipe.reader import load
from lemma.dataset.recipe.schema import PerturbedRecord
from lemma.expert.disturbances import Perturbation

TASKS = ("stack", "hook")
SPLIT = "train"
EPISODES = 2
PERTURBATION = Perturbation(0.6, seed=1)


def perturbed_order(out: Path) -> GenerateConfig:
    """Return an order of four short episodes."""
    return GenerateConfig(
        out=out, tasks=TASKS, splits=(SPLIT,), episodes=EPISODES, perturb=PERTURBATION
    )


@cache
def perturbed_recipe() -> Path:
    """Return a recipe of that order; do not write there."""
    folder = Path(mkdtemp(prefix="lemma-perturbed-"))
    atexit.register(rmtree, folder, ignore_errors=True)
    generate(perturbed_order(folder), Serial())
    return folder


def perturbed_records() -> list[PerturbedRecord]:
    """Return its episodes."""
    found = list(load(perturbed_recipe()))
    return [record for record in found if isinstance(record, PerturbedRecord)]
