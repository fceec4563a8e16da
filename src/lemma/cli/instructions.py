"""`lemma instructions`: instructions of a task."""

from collections.abc import Iterator
from itertools import count, islice
from typing import Literal

import numpy as np

from lemma.cli.options import JsonFlag, TaskName, print_json, print_table
from lemma.core.errors import InvalidConfigError
from lemma.core.seeding import stream
from lemma.dataset.instructions import draw_instruction
from lemma.expert.expert import Expert
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.language.bank import instruct, robot_phrases, sub_instruction
from lemma.tasks.language.relational import check_relational, relational
from lemma.tasks.language.template import RELATIONAL
from lemma.tasks.suite import TASKS, default_split, load_instance

_HEADER = ("instance", "instruction")
Kind = Literal["training", "high_level", "human", "unseen", "relational", "sub"]


def instructions(
    task: TaskName,
    n: int = 20,
    kind: Kind = "training",
    seed: int = 0,
    as_json: JsonFlag = False,
) -> int:
    """Draw instructions of a task, as in training or of one kind.

    Args:
        task: Name of the task.
        n: Number of sentences.
        kind: training draws from high_level and human, as training does; sub prints
            the sub-instructions of the expert's plan.
        seed: Seed of the draws.
        as_json: Print a JSON list instead of a table.
    """
    TASKS[task]
    if kind == RELATIONAL:
        check_relational(task)
    if n < 1 or seed < 0:
        raise InvalidConfigError(
            f"--n is at least 1 and --seed at least 0, not {n} and {seed}."
        )
    drawn = islice(_draw(task, kind, seed), n)
    rows = [(instance.key, text) for instance, text in drawn]
    if as_json:
        print_json([dict(zip(_HEADER, row, strict=True)) for row in rows])
    else:
        print_table(_HEADER, rows, labels=2)
    return 0


def _draw(task: str, kind: Kind, seed: int) -> Iterator[tuple[Instance, str]]:
    """Yield training instances, sampled if there is no list, and their sentences."""
    draws = stream("instructions", task, seed)
    for number in count():
        index = int(draws.integers(splits_of(task)["train"]))
        instance = load_instance(task, default_split(task), index)
        for text in _sentences(instance, kind, seed, number, draws):
            yield instance, text


def _sentences(
    instance: Instance, kind: Kind, seed: int, epoch: int, draws: np.random.Generator
) -> list[str]:
    pairs = instance.goal.pairs
    if kind == RELATIONAL:
        return [relational(instance)]
    if kind == "sub":
        return _plan(instance)
    if kind == "training":
        return [
            draw_instruction(instance.task, pairs, instance.key, seed=seed, epoch=epoch)
        ]
    return [instruct(instance.task, kind, pairs, draws)]


def _plan(instance: Instance) -> list[str]:
    """Return the sub-instructions of the expert's plan, in order."""
    names = robot_phrases(instance.scene.robots)
    spoken = dict(zip(instance.scene.robot_names, names, strict=True))
    plan = Expert(Scene(instance.scene), instance.goal).plan()
    steps = plan.steps if plan is not None else ()
    return [
        sub_instruction(
            spoken[step.subtask.robot],
            str(step.subtask.primitive),
            step.subtask.pick,
            step.subtask.place,
        )
        for step in steps
    ]
