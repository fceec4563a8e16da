"""Types of options and consoles that several verbs use."""

import codecs
import io
import json
import os
import sys
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.core.tables import Table
from lemma.tasks.names import SUITES

# Without a hint: it would add "(default: None)" to a help text with the default.
Flag = Annotated[
    bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")
]
"""A flag that is off by default."""
JsonFlag = Annotated[Flag, tyro.conf.arg(name="json", help_behavior_hint="")]
"""``--json``: print only one JSON document on the standard output."""
TaskNames = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="[TASK ...]", help_behavior_hint=""),
]
"""Any number of tasks."""
TaskName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
"""Exactly one task."""
MaybeTask = Annotated[
    str | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="[TASK]", help_behavior_hint=""),
]
"""A task, which a file may name instead."""
Data = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
"""A recipe or another data set, or the file of a teleoperated episode."""
Results = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="RESULT ...", help_behavior_hint=""),
]
"""Folders or files of results."""
Word = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")]
"""An optional name."""
ALL = "all"
Listed = Annotated[str, tyro.conf.arg(metavar="NAME,...")]
"""Names separated by commas, or ``all``; see :func:`words`."""
SuiteName = Literal["lemma", "ladder", "teams"]
"""A suite: a key of :data:`lemma.tasks.names.SUITES`."""
Arguments = Annotated[
    str, tyro.conf.arg(metavar="NAME=VALUE,...", help_behavior_hint="")
]
"""Arguments of a policy's class; see :func:`arguments`."""
Number = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
"""An optional number."""
Team = Annotated[str | None, tyro.conf.arg(metavar="ARM,ARM", help_behavior_hint="")]
"""Optional arm types, from left to right."""
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
"""An optional file."""
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
"""An optional folder."""


def output() -> Console:
    """Return the console for results: the standard output.

    Square brackets are printed as text, not read as markup.
    """
    return Console(markup=False, highlight=False, emoji=False)


def messages() -> Console:
    """Return the console for progress and messages: the error stream."""
    return Console(stderr=True, markup=False, highlight=False, emoji=False)


def complain(text: str) -> None:
    """Print an error message on the error stream."""
    messages().print(text, style="bold red", soft_wrap=True)


def print_json(document: Any) -> None:
    """Print a JSON document on the standard output."""
    is_utf8 = codecs.lookup(sys.stdout.encoding or "utf-8").name == "utf-8"
    text = json.dumps(document, indent=2, ensure_ascii=not is_utf8)
    sys.stdout.write(f"{text}\n")


def print_table(
    header: tuple[str, ...],
    rows: Iterable[tuple[object, ...]],
    title: str = "",
    labels: int = 1,
    bold: Container[int] = (),
) -> None:
    """Print a table on the standard output.

    Args:
        header: Headings of the columns.
        rows: Cells, row by row.
        title: Title above the table; empty for none.
        labels: Number of columns, from the left, that contain text instead of numbers.
        bold: Indices of bold rows.
    """
    cells = tuple(tuple(map(str, row)) for row in rows)
    if title:
        output().print(f"\n{title}", style="bold", soft_wrap=True)
    output().print(Table(header, cells, labels).terminal(bold))


def print_named(*lines: tuple[str, object], style: str = "") -> None:
    """Print values on the standard output, one per line, each after its name."""
    for name, text in lines:
        output().print(f"{name:<11}{text}", style=style, soft_wrap=True)


def print_figures(
    found: Mapping[str, float], forms: Mapping[str, tuple[str, ...]], title: str
) -> None:
    """Print figures on the standard output, one per line.

    Args:
        found: The figures by name.
        forms: Meaning, format and, optionally, target of each figure.
        title: Title above the table.
    """
    header = ("figure", "measured", "target")[: max(map(len, forms.values()))]
    rows = (
        (meaning, form.format(found[name]), *target)
        for name, (meaning, form, *target) in forms.items()
    )
    print_table(header, rows, title)


def prepare_streams() -> None:
    """Make both streams print a question mark for characters that their locale lacks.

    Closed streams are replaced by ones without output.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper) and _refuses_letters(stream):
            stream.reconfigure(errors="replace")


def _refuses_letters(stream: io.TextIOWrapper) -> bool:
    # Beyond ASCII, the locale "C" accepts only undecodable file names
    # ("surrogateescape").
    is_utf8 = codecs.lookup(stream.encoding).name == "utf-8"
    return stream.errors == "strict" or (
        stream.errors == "surrogateescape" and not is_utf8
    )


def words(listed: str, every: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Return the words of a list separated by commas, each once.

    Args:
        listed: The list.
        every: Words that replace ``all``; None to keep it.

    Raises:
        InvalidConfigError: The list is empty.
    """
    if every is not None and listed.strip() == ALL:
        return every
    found = tuple(dict.fromkeys(w.strip() for w in listed.split(",") if w.strip()))
    if not found:
        raise InvalidConfigError(
            f"{listed!r} contains no name. Separate names by commas: train,val."
        )
    return found


def task_names(listed: str, suite: str) -> tuple[str, ...]:
    """Return the listed tasks, or all of a suite for ``all``.

    Raises:
        UnknownNameError: No such suite.
        InvalidConfigError: The list is empty.
    """
    return words(listed, every=SUITES[known("suite", suite, SUITES)])


def arguments(text: str) -> tuple[tuple[str, Any], ...]:
    """Return names and values of ``NAME=VALUE,...``.

    Args:
        text: Text of the option.

    Raises:
        InvalidConfigError: An equals sign is missing.
    """
    found = []
    for part in filter(None, text.split(",")):
        name, equals, value = part.partition("=")
        if not equals or not name.isidentifier():
            raise InvalidConfigError(
                f"{part!r} is not an argument. Write NAME=VALUE,..., as in "
                "--policy-args checkpoint=model.pt,chunk=8."
            )
        found.append((name, _value(value)))
    return tuple(found)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
