"""`lemma train`: training of a model on rendered keyframes."""

from dataclasses import asdict
from typing import Annotated

import tyro

from lemma.cli.options import (
    Flag,
    JsonFlag,
    messages,
    output,
    print_json,
    print_table,
)
from lemma.policies.training.config import TrainingConfig

INTERRUPTED = 130


def train(
    config: Annotated[TrainingConfig, tyro.conf.arg(name="")],
    restart: Flag = False,
    as_json: JsonFlag = False,
) -> int:
    """Train a model, or continue an interrupted run.

    The folder of the run gets the best weights by validation, the configuration, logs
    for TensorBoard and a report. The same command continues after Ctrl-C or a crash,
    with the same result.

    Args:
        config: Options of the training run.
        restart: Start from the beginning, even if the folder has a run.
        as_json: Print the report as JSON.

    Returns:
        Exit code: 130 if it was interrupted.
    """
    # Import late: torch is optional.
    from lemma.policies.training import loop

    report = loop.train(config, restart=restart)
    interrupted = report.status == "interrupted"
    if as_json:
        print_json(asdict(report))
    elif interrupted:
        messages().print(
            f"Interrupted after {report.steps} steps, which are saved. The same "
            "command continues from there.",
            soft_wrap=True,
        )
    else:
        _print(config, report)
    return INTERRUPTED if interrupted else 0


def _print(config: TrainingConfig, report: object) -> None:
    fields = vars(report)
    kinds = fields["scores_by_kind"]
    rows = [
        (name, *(f"{of[name]:.4f}" for of in (fields["scores"], *kinds.values())))
        for name in fields["scores"]
    ]
    header = ("score", "best weights", *(kind.replace("_", " ") for kind in kinds))
    print_table(header, rows)
    output().print(
        f"{config.out / 'weights.safetensors'}: {fields['parameters']:,} weights "
        f"from step {fields['best_step']} of {fields['steps']}, in "
        f"{fields['seconds']:.0f} s of training "
        f"({fields['samples_per_s']:.0f} frames/s on {fields['device']}, which waited "
        f"for input {fields['input_wait']:.1%} of the time).",
        soft_wrap=True,
    )
