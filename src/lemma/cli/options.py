"""What the verbs share: where they print, and how flags look."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

# The hint would repeat "(default: None)" where the help says what happens.
Flag = Annotated[
    bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")
]
"""A switch that is off unless it is named."""
JsonFlag = Annotated[Flag, tyro.conf.arg(name="json", help_behavior_hint="")]
"""``--json``: one JSON document on the output, and nothing else."""
TaskNames = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="[TASK ...]", help_behavior_hint=""),
]
"""Any number of tasks."""
TaskName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
"""Exactly one task."""
Word = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")]
"""An optional name."""
Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
"""An optional number."""
Team = Annotated[str | None, tyro.conf.arg(metavar="ARM,ARM", help_behavior_hint="")]
"""Optional arm types, from left to right."""
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
"""An optional file."""
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
"""An optional folder."""


def output() -> Console:
    """Return the console for results: the standard output."""
    return Console(highlight=False, emoji=False)


def messages() -> Console:
    """Return the console for progress and complaints: the error stream."""
    return Console(stderr=True, highlight=False, emoji=False)


def complain(text: str) -> None:
    """Print an error message for people."""
    messages().print(text, style="bold red", markup=False, soft_wrap=True)


def print_json(document: Any) -> None:
    """Print a document for programs."""
    sys.stdout.write(json.dumps(document, indent=2, ensure_ascii=False) + "\n")
