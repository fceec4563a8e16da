"""The exceptions that this package raises on purpose.

Each message says what was wrong, what is valid and what to try.
"""

import difflib
import reprlib
from collections.abc import Iterable
from typing import Self

_LONGEST = 100
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 80
_REPR.maxlevel = 3


def shown(value: object) -> str:
    """Return any value as a message shows it: short, however large or deep it is."""
    text = _REPR.repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


class LemmaError(Exception):
    """Base of every error raised on purpose by this package."""


class UnknownNameError(LemmaError, ValueError):
    """A name that is not in a registry: a task, a robot, a color, a camera."""

    def __init__(self, kind: str, name: object, valid: Iterable[str]) -> None:
        """Build the message from the valid names.

        Args:
            kind: Noun for the kind of thing that was looked up: ``"task"``.
            name: The name that was not found.
            valid: Every name that would have been accepted.
        """
        names = list(valid)
        close = difflib.get_close_matches(str(name), names, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        valid_names = ", ".join(names) or "(none)"
        super().__init__(f"Unknown {kind} {shown(name)}.{hint} Valid: {valid_names}.")
        self._looked_up = (kind, name, names)

    def __reduce__(self) -> tuple[type[Self], tuple[str, object, list[str]]]:
        """Return how another process builds it again: its message is no argument."""
        return type(self), self._looked_up


class InvalidActionError(LemmaError, ValueError):
    """An action of the wrong shape, out of bounds, or not finite."""


class InvalidConfigError(LemmaError, ValueError):
    """A configuration value that cannot be used."""


class PluginError(LemmaError, RuntimeError):
    """A module of a user that cannot be imported."""


class SamplingError(LemmaError, RuntimeError):
    """No instance was found that satisfies a task's constraints."""


class RenderingError(LemmaError, RuntimeError):
    """No OpenGL library could be used to render off screen."""


class ResetNeededError(LemmaError, RuntimeError):
    """``step`` was called before ``reset``, or after the episode had ended."""


class PhysicsError(LemmaError, RuntimeError):
    """The simulation became unstable; its state means nothing any more."""


class DatasetError(LemmaError, RuntimeError):
    """A dataset that cannot be read, written or trusted."""


class WorkerError(LemmaError, RuntimeError):
    """Processes or machines that work keep dying, or cannot be had."""


class CapacityError(LemmaError, RuntimeError):
    """There is no room for what a scene needs: a defect of this package."""


class WeightsError(LemmaError, RuntimeError):
    """Weights that cannot be found, read or used."""
