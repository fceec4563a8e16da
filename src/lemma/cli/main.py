"""The `lemma` command: its verbs, and the reports of errors."""

import ast
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

import tyro
from rich.table import Table
from rich.text import Text

from lemma.cli.options import complain, output, prepare_streams
from lemma.core.errors import LemmaError, UnknownNameError
from lemma.core.plugins import load_plugins, split_names
from lemma.core.version import VERSION as __version__
from lemma.core.version import extra_of

VERBS = (
    *("tasks", "play", "demo", "show", "schedule", "doctor", "bench", "audit"),
    *("generate", "replay", "inspect", "push-to-hub", "pull", "render"),
    *("instructions", "train", "evaluate", "serve", "verify"),
    *("compare", "report", "reproduce"),
)
"""The verbs, in the order of the help.

A verb is a function in the module of the same name in this package, with underscores
for dashes. Its parameters are its options. Its module is imported only for this verb,
since importing all of them takes seconds.
"""

_DESCRIPTION = (
    "LEMMA Bench: two to four robot arms, a table, and instructions that no arm can "
    "follow alone."
)
INTERRUPTED = 130
"""Exit code after Ctrl-C, as in shells."""
BAD_INPUT = 2
"""Exit code for errors that the user can correct, including errors of arguments."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, and exit with its exit code.

    Args:
        arguments: Words after `lemma`; None for those of this process.

    Raises:
        SystemExit: Always.
    """
    prepare_streams()
    words, plugins = split_plugins(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(words, plugins)
    except LemmaError as error:
        complain(str(error))
        code = BAD_INPUT
    except ImportError as error:
        complain(_about_missing(error))
        code = BAD_INPUT
    except KeyboardInterrupt as interrupt:
        # The message of the exception comes from `progress_bar`.
        complain(str(interrupt) or "Interrupted: nothing is saved.")
        code = INTERRUPTED
    except BrokenPipeError:
        # The output's reader has closed it; avoid a second error when it is flushed.
        sys.stderr.close()
        code = 0
    except OSError as error:
        # Such as a folder without permission to write, or a file in place of a folder.
        place = f"{error.filename} cannot be used: " if error.filename else ""
        complain(f"{place}{error.strerror or error}.")
        code = BAD_INPUT
    raise SystemExit(code)


def _run(words: list[str], plugins: list[str]) -> int:
    if words == ["--version"]:
        output().print(f"lemma {__version__}")
        return 0
    if not words or words[0] in ("-h", "--help"):
        _print_help()
        return 0
    load_plugins(plugins)
    code: int = tyro.extras.subcommand_cli_from_dict(
        _functions(words), prog="lemma", description=_DESCRIPTION, args=words
    )
    return code


def split_plugins(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Remove every ``--plugin NAME`` from a command line.

    Plugins are imported before the other words are parsed, because these may be names
    that a plugin registers.

    Returns:
        The other words, and the plugins.
    """
    others: list[str] = []
    plugins: list[str] = []
    rest = iter(words)
    for word in rest:
        option, is_equal, value = word.partition("=")
        if option == "--plugin":
            plugins += split_names(value if is_equal else next(rest, ""))
        else:
            others.append(word)
    return others, plugins


def _functions(words: Sequence[str]) -> dict[str, Callable[..., int]]:
    """Return the verbs that a command line needs.

    Raises:
        UnknownNameError: Its first word is not a verb.
        ImportError: A required package is not installed.
    """
    first = words[0]
    if first in VERBS:
        return {first: _imported(first)}
    if not first.startswith("-"):
        raise UnknownNameError("verb", first, VERBS)
    # Shell completion needs every option of every verb.
    return {verb: _imported(verb) for verb in VERBS}


def _imported(verb: str) -> Callable[..., int]:
    name = verb.replace("-", "_")
    function: Callable[..., int] = getattr(import_module(f"lemma.cli.{name}"), name)
    return function


def summary_of(verb: str) -> str:
    """Return the first line of a verb's help without importing its module."""
    name = verb.replace("-", "_")
    source = Path(__file__).with_name(f"{name}.py").read_text("utf-8")
    (function,) = (
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.FunctionDef) and node.name == name
    )
    return (ast.get_docstring(function) or "").partition("\n")[0]


def _print_help() -> None:
    console = output()
    options = "[--help] [--version] [--plugin NAME]"
    console.print(f"usage: lemma {options} VERB ...\n\n{_DESCRIPTION}\n")
    verbs = Table.grid(padding=(0, 2))
    for verb in VERBS:
        verbs.add_row(f"  {verb}", Text(summary_of(verb)))
    console.print(verbs)
    console.print(
        "\n'lemma VERB --help' explains a verb. --plugin my_module, or my_file.py, "
        "registers your own tasks, arms or primitives first."
    )


def _about_missing(error: ImportError) -> str:
    extra = extra_of(error.name or "")
    if extra is None:
        return (
            f"{error}. The installation is incomplete; repair it with: "
            "python -m pip install --force-reinstall lemma-bench"
        )
    return (
        f"This needs {error.name}, which comes with an extra: python -m pip install "
        f"'lemma-bench[{extra}]', or '.[{extra}]' in a checkout."
    )
