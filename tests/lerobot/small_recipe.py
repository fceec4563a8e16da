"""A recipe of one episode for each of two tasks and two splits."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate

TASKS = ("pass", "stack")
SPLITS = ("train", "val")


@cache
def recipe() -> Path:
    out = Path(mkdtemp(prefix="lemma-lerobot-"))
    generate(GenerateConfig(out=out, tasks=TASKS, splits=SPLITS, episodes=1), Serial())
    return out
