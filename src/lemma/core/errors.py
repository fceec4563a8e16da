"""The exceptions of this package.

Each message has the invalid value, the valid values and a suggestion.
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
    """Return a short text of any value for messages, even if it is large or deep."""
    text = _REPR.repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


class LemmaError(Exception):
    """Base class of all errors of this package."""


class UnknownNameError(LemmaError, ValueError):
    """An unknown name, such as that of a task, a robot, a color or a camera."""

    def __init__(self, kind: str, name: object, valid: Iterable[str]) -> None:
        """Build the message from the valid names.

        Args:
            kind: Noun for what the name denotes, such as ``"task"``.
            name: The unknown name.
            valid: All valid names.
        """
        names = list(valid)
        close = difflib.get_close_matches(str(name), names, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        valid_names = ", ".join(names) or "(none)"
        super().__init__(f"Unknown {kind} {shown(name)}.{hint} Valid: {valid_names}.")
        self._looked_up = (kind, name, names)

    def __reduce__(self) -> tuple[type[Self], tuple[str, object, list[str]]]:
        """Support pickling: the arguments of ``__init__`` are not the message."""
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
    """The simulation became unstable; its state is invalid."""


class DatasetError(LemmaError, RuntimeError):
    """A dataset that cannot be read, written or trusted."""


class WorkerError(LemmaError, RuntimeError):
    """Worker processes or machines end repeatedly, or cannot be started."""


class CapacityError(LemmaError, RuntimeError):
    """A buffer is too small for a scene: a defect of this package."""


class WeightsError(LemmaError, RuntimeError):
    """Weights that cannot be found, read or used."""
