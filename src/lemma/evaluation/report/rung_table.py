"""Tables of the ladder's rungs: one row for each policy, and the commands of all rows.

ACT and Diffusion Policy are one policy for each rung; they share a row here.
"""

import re
from collections.abc import Iterable, Mapping

from lemma.core.tables import Table
from lemma.evaluation.experiments.catalog import AND, CONTROL_LEVEL
from lemma.evaluation.report.policy_results import NOTHING, PolicyResults, shown
from lemma.policies.class_path import LEROBOT
from lemma.tasks.names import LADDER

_ALONE = re.compile(r", \w+ alone$")
"""End of the title of a policy that is trained on one rung."""


def rung_table(entries: Iterable[PolicyResults], kind: str = "high_level") -> Table:
    """Return strict success by rung of policies at control level that were played.

    Args:
        entries: Results by policy.
        kind: Kind of instructions.
    """
    found: dict[str, dict[str, str]] = {}
    for entry in _of_ladder(entries):
        for task in LADDER:
            rate = shown(entry.select(kind, task=task))
            if rate != NOTHING:
                found.setdefault(_ALONE.sub("", entry.title), {})[task] = rate
    tasks = [task for task in LADDER if any(task in row for row in found.values())]
    rows = (
        (title, *(rates.get(task, NOTHING) for task in tasks))
        for title, rates in found.items()
    )
    return Table(("success [%]", *tasks), tuple(rows))


def command_table(
    entries: Iterable[PolicyResults], seconds: Mapping[str, str]
) -> Table:
    """Return the commands of policies at control level that were played.

    Args:
        entries: Results by policy.
        seconds: Times of trainings by name of the weights, where there are records.
    """
    rows = []
    for entry in _of_ladder(entries):
        one = entry.experiment
        if one is None or not entry.results:
            continue
        trained = one.training.replace("{seed}", "SEED").split(AND)
        rows.append(
            (
                entry.title,
                f"`{entry.results[0].command}`",
                ", then ".join(f"`{part}`" for part in trained if part) or NOTHING,
                seconds.get(one.policy.name.removeprefix(LEROBOT), NOTHING),
            )
        )
    header = ("row", "makes the row", "trains its weights", "seconds, by seed")
    return Table(header, tuple(rows), labels=3)


def _of_ladder(entries: Iterable[PolicyResults]) -> list[PolicyResults]:
    return [entry for entry in entries if entry.suite == CONTROL_LEVEL]
