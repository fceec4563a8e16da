"""What the verbs share: where they print, and how flags look."""

import json
import sys
from typing import Annotated, Any

import tyro
from rich.console import Console

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""A switch that is off unless it is named."""
JsonFlag = Annotated[Flag, tyro.conf.arg(name="json")]
"""``--json``: one JSON document on the output, and nothing else."""


def output() -> Console:
    """Return the console for results: the standard output."""
    return Console(highlight=False)


def messages() -> Console:
    """Return the console for progress and complaints: the error stream."""
    return Console(stderr=True, highlight=False)


def complain(text: str) -> None:
    """Print an error message for people."""
    messages().print(text, style="bold red", markup=False, soft_wrap=True)


def print_json(document: Any) -> None:
    """Print a document for programs."""
    sys.stdout.write(json.dumps(document, indent=2, ensure_ascii=False) + "\n")
