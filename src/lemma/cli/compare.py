"""`lemma compare`: two results on the same episodes."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.options import JsonFlag, messages, print_json, print_table
from lemma.evaluation.analysis.comparison import Comparison
from lemma.evaluation.analysis.comparison import compare as run

_HEADER = (
    *("success [%]", "1st", "2nd", "difference (95 %)"),
    *("only 1st", "only 2nd", "p"),
)
ResultFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
"""A result of ``lemma evaluate`` or ``lemma reproduce``."""


def compare(
    first: ResultFolder, second: ResultFolder, as_json: JsonFlag = False
) -> int:
    """Compare two policies on the same episodes, one by one.

    Prints the difference of the strict success rates with its 95 % interval
    (Newcombe's, for paired rates), the numbers of episodes in which only one policy
    succeeded, and the p-value of McNemar's exact test. The last row of each kind has
    lenient success. Episodes that only one result has are left out. Results of other
    versions are refused.

    Args:
        first: Folder or file of the first result.
        second: Folder or file of the second result.
        as_json: Print one JSON object instead of a table.
    """
    compared = run(first, second)
    found = compared.by_kind
    if any(compared.unpaired):
        only_first, only_second = compared.unpaired
        messages().print(
            f"Compared on the {compared.common:,} episodes of both results; the first "
            f"has {only_first:,} others, the second {only_second:,}.",
            soft_wrap=True,
        )
    if as_json:
        print_json(
            {
                kind: {task: asdict(one) for task, one in by_task.items()}
                for kind, by_task in found.items()
            }
        )
        return 0
    rows = []
    for kind, by_task in found.items():
        for task, one in by_task.items():
            # The last row of a kind is all of its tasks with lenient success.
            name = kind.replace("_", "-") if task == "all" else f"  {task}"
            rows.append((name, *_cells(one)))
    print_table(_HEADER, rows)
    return 0


def _cells(one: Comparison) -> tuple[str, ...]:
    first, second = one.success_rates
    low, high = one.interval
    return (
        f"{100 * first:.1f}",
        f"{100 * second:.1f}",
        f"{100 * one.difference:+.1f} ({100 * low:+.0f} to {100 * high:+.0f})",
        str(one.only_first),
        str(one.only_second),
        "<.0001" if one.p_value < 0.0001 else f"{one.p_value:.4f}",
    )
