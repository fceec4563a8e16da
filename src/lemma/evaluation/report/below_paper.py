"""The table of the tasks in which a policy is below the paper's figure, and why."""

from collections.abc import Iterable
from statistics import fmean

from lemma.core.tables import Table
from lemma.evaluation.report.policy_results import PolicyResults, pooled, shown
from lemma.tasks.language.template import ALL_KINDS


def below_paper(entries: Iterable[PolicyResults]) -> Table:
    """Return the tasks of lower strict success than in the paper, with the causes.

    Args:
        entries: Results by policy.
    """
    rows = []
    for entry in entries:
        figures = entry.experiment.paper if entry.experiment else {}
        for kind in (kind for kind in ALL_KINDS if kind in figures):
            for task, paper in figures[kind].tasks.items():
                seeds = [cells for cells in entry.select(kind, task=task) if cells]
                if seeds and 100.0 * fmean(map(pooled, seeds)) < paper.mean:
                    counted = entry.causes(kind, task)
                    causes = ", ".join(
                        f"{cause.replace('_', ' ')} {count}"
                        for cause, count in counted.most_common()
                    )
                    instructions = kind.replace("_", "-")
                    found = shown(seeds), str(paper), str(counted.total()), causes
                    rows.append((entry.title, instructions, task, *found))
    header = ("", "instructions", "task", "success [%]", "paper", "failed", "causes")
    return Table(header, tuple(rows), labels=3)
