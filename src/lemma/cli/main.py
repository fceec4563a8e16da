"""The `lemma` command: one verb per file, and one way of reporting errors."""

import sys
from collections.abc import Callable, Sequence
from importlib import import_module

import tyro

from lemma import __version__
from lemma.cli.options import complain, output
from lemma.core.errors import LemmaError

VERBS = (
    *("tasks", "demo", "show", "doctor", "bench"),
    *("generate", "replay", "inspect", "push-to-hub", "pull"),
    *("render", "instructions", "train", "evaluate", "serve"),
    *("compare", "report", "reproduce"),
)
"""Each is a function of the same name in a module of the same name in this package,
with underscores for dashes."""

_DESCRIPTION = (
    "LEMMA Bench: two robot arms, a table, and instructions that neither arm can "
    "follow alone.\n\n'lemma VERB --help' says more about each verb."
)
BAD_INPUT = 2
"""Exit code for what the user can put right; argument errors use it as well."""
_EXTRAS = {"torch": "learn", "safetensors": "learn", "tensorboard": "learn"}
"""The extra of this package with which a module comes."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    Args:
        arguments: Words after `lemma`; those of this process if None.

    Raises:
        SystemExit: Always.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words == ["--version"]:
        output().print(f"lemma {__version__}")
        raise SystemExit(0)
    words = words or ["--help"]
    # What one verb needs takes a second to import, so the others do without.
    asked = words[0] if words[:1] and words[0] in VERBS else None
    verbs = (asked,) if asked else VERBS
    try:
        functions: dict[str, Callable[..., int]] = {
            verb: getattr(import_module(f"lemma.cli.{name}"), name)
            for verb in verbs
            for name in (verb.replace("-", "_"),)
        }
        code = tyro.extras.subcommand_cli_from_dict(
            functions, prog="lemma", description=_DESCRIPTION, args=words
        )
    except LemmaError as error:
        complain(str(error))
        code = BAD_INPUT
    except ImportError as error:
        complain(_about_missing(error))
        code = BAD_INPUT
    except KeyboardInterrupt:
        complain("Interrupted.")
        code = 130
    except BrokenPipeError:
        # Whoever read our output has seen enough; closing it must not fail as well.
        sys.stderr.close()
        code = 0
    except OSError as error:
        # A folder that cannot be written to, a file where a folder should be.
        complain(str(error))
        code = BAD_INPUT
    raise SystemExit(code)


def _about_missing(error: ImportError) -> str:
    extra = _EXTRAS.get((error.name or "").partition(".")[0])
    if extra is None:
        return (
            f"{error}. The installation is incomplete; repair it with: "
            "python -m pip install --force-reinstall lemma-bench"
        )
    return (
        f"This takes {error.name}, which comes with an extra: python -m pip install "
        f"'lemma-bench[{extra}]', or '.[{extra}]' in a checkout."
    )
