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
"""A result that ``lemma evaluate`` or ``lemma reproduce`` wrote."""


def compare(
    first: ResultFolder, second: ResultFolder, as_json: JsonFlag = False
) -> int:
    """Compare two policies on the same episodes, one by one.

    Prints the difference of their strict success rates with its 95 % interval
    (Newcombe's, for paired rates), on how many episodes only one of them succeeded, and
    the p-value of McNemar's exact test; last of each kind, the same leniently. Episodes
    that only one of them has are left out. Results of other versions are refused.

    Args:
        first: Folder or file of a result.
        second: The other.
        as_json: Print one JSON object instead of a table.
    """
    compared = run(first, second)
    found = compared.by_kind
    if any(compared.unpaired):
        only_first, only_second = compared.unpaired
        messages().print(
            f"Compared on the {compared.common:,} episodes that both have; the first "
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
            # Last of a kind, all of its tasks once more, leniently.
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
