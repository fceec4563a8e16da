"""What callers pass: numbers and names, checked where they come in."""

import contextlib
import math
import operator
import os
from collections.abc import Iterable
from numbers import Real
from typing import SupportsIndex

import numpy as np

from lemma.core.errors import InvalidConfigError, UnknownNameError, shown


def whole(
    name: str, value: object, low: int | None = None, high: int | None = None
) -> int:
    """Return a whole number within bounds.

    Args:
        name: What it is called, for the message.
        value: What was passed; NumPy's integers are fine, truth values are not.
        low: Smallest that is valid.
        high: Largest that is valid.

    Raises:
        InvalidConfigError: It is none.
    """
    is_index = isinstance(value, SupportsIndex) and not isinstance(value, bool)
    try:
        number = operator.index(value) if is_index else None  # type: ignore[arg-type]
    except TypeError:
        # Arrays look like indices and are none, but for a single whole number.
        number = None
    if number is None or not _within(number, low, high):
        raise InvalidConfigError(
            f"{name}={shown(value)} is impossible. It must be a whole number"
            f"{_range(low, high)}."
        )
    return number


def real(
    name: str, value: object, low: float | None = None, high: float | None = None
) -> float:
    """Return a finite number within bounds.

    Args:
        name: What it is called, for the message.
        value: What was passed; NumPy's numbers are fine, truth values are not.
        low: Smallest that is valid.
        high: Largest that is valid.

    Raises:
        InvalidConfigError: It is none.
    """
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            number = float(value)
    if not math.isfinite(number) or not _within(number, low, high):
        raise InvalidConfigError(
            f"{name}={shown(value)} is impossible. It must be a finite number"
            f"{_range(low, high)}."
        )
    return number


def flag(name: str, value: object) -> bool:
    """Return a truth value.

    Args:
        name: What it is called, for the message.
        value: What was passed; NumPy's truth values are fine, numbers are not.

    Raises:
        InvalidConfigError: It is none.
    """
    if not isinstance(value, bool | np.bool_):
        raise InvalidConfigError(
            f"{name}={shown(value)} is impossible. It must be True or False."
        )
    return bool(value)


def known(kind: str, name: object, valid: Iterable[str]) -> str:
    """Return a name that is one of the valid ones.

    Args:
        kind: What it is, as a noun.
        name: What was passed.
        valid: Every name that exists.

    Raises:
        UnknownNameError: There is no such name.
    """
    names = tuple(valid)
    if not isinstance(name, str) or name not in names:
        raise UnknownNameError(kind, name, names)
    return name


def secret_of(variable: str) -> str:
    """Return the secret in an environment variable, ready for a header of HTTP.

    Args:
        variable: Its name; the secret is empty where there is none.

    Raises:
        InvalidConfigError: It cannot be sent.
    """
    secret = os.environ.get(variable, "").strip(" \t\r\n\ufeff")
    if not (secret.isascii() and secret.isprintable()):
        raise InvalidConfigError(
            f"The secret in the environment variable {variable} cannot be sent: it "
            "holds a line break, a curly quotation mark or another character that is "
            "not printable ASCII. Set the variable again."
        )
    return secret


def _within(number: float, low: float | None, high: float | None) -> bool:
    return (low is None or number >= low) and (high is None or number <= high)


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "" if low is None else f", at least {low:g}"
    return f" from {low:g} to {high:g}"
