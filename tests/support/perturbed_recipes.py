"""A small recipe of perturbed executions, made once for several tests."""

from pathlib import Path

from kept import kept_folder

from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.files import load
from lemma.dataset.recipe.generate import GenerateConfig, generate
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


def perturbed_recipe() -> Path:
    """Return a recipe of that order; do not write there."""
    return kept_folder("perturbed", lambda o: generate(perturbed_order(o), Serial()))


def perturbed_records() -> list[PerturbedRecord]:
    """Return its episodes."""
    found = list(load(perturbed_recipe()))
    return [record for record in found if isinstance(record, PerturbedRecord)]
