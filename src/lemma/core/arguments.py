"""Checks of numbers, names and dataclasses that callers pass."""

import contextlib
import math
import operator
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from numbers import Real
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    SupportsIndex,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
import numpy as np

from lemma.core.errors import InvalidConfigError, LemmaError, UnknownNameError, shown

T = TypeVar("T")

Width = Annotated[int, msgspec.Meta(ge=1, le=4096)]
"""Channels of a map, or values of a token."""
Widths = Annotated[tuple[Width, ...], msgspec.Meta(min_length=1, max_length=8)]
"""Channels of each level of a network."""
Depth = Annotated[int, msgspec.Meta(ge=1, le=64)]
"""Layers, blocks or heads."""
Count = Annotated[int, msgspec.Meta(ge=1, le=1024)]
"""A number of things that are not built of weights."""
Share = Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)]
"""Part of a whole, less than all of it."""
Deviation = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
"""Standard deviation of noise."""
Size = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
"""Size of something on the table [m]."""
Height = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
"""Above the table top [m]."""
Cost = Annotated[float, msgspec.Meta(ge=0.0, le=1e3)]
"""Loss of log-probability."""
Temperature = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
"""Divides log-probabilities."""
Extent = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
"""Extent of a part of the table [m]."""


def whole(
    name: str, value: object, low: int | None = None, high: int | None = None
) -> int:
    """Return a whole number within bounds.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's integers are fine, truth values are not.
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
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's numbers are fine, truth values are not.
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
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's truth values are fine, numbers are not.

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
        kind: Noun for the kind of thing that is named, for the message.
        name: Name to check.
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


def check_address_has_no_secret(url: str, whose: str, advice: str) -> None:
    """Check that an address has no user's name, query, fragment or parameters.

    Args:
        url: The address; the message does not show it.
        whose: Owner of the address, such as ``"a chat server"``.
        advice: A sentence that says where the secret belongs.

    Raises:
        InvalidConfigError: It has one of them.
    """
    if any(mark in url for mark in "@?#;"):
        raise InvalidConfigError(
            f"The address of {whose} holds no password and no key, since results name "
            f"it: leave out what stands with @, ?, # or a semicolon. {advice}"
        )


def without_passwords(text: str) -> str:
    """Return a text in which no address has a user's name and a password."""
    return re.sub(r"\S+@(?=\S)", "***@", text)


def _within(number: float, low: float | None, high: float | None) -> bool:
    return (low is None or number >= low) and (high is None or number <= high)


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "" if low is None else f", at least {_said(low)}"
    return f" from {_said(low)} to {_said(high)}"


def _said(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:g}"


def decode(kind: type[T], data: Any) -> T:
    """Return a dataclass from plain data, such as JSON.

    Types are strict: a text that reads like a number is no number. Ranges are those of
    the fields' annotations.

    Args:
        kind: The dataclass; its fields may be dataclasses, too.
        data: A mapping with some of its fields.

    Raises:
        UnknownNameError: There is no field of that name.
        InvalidConfigError: A value is of another type or out of its range, or one that
            has no default is missing.
    """
    _check_names(kind, data)
    try:
        return msgspec.convert(data, kind, dec_hook=_path)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, LemmaError):
            raise error.__cause__ from None
        raise InvalidConfigError(f"{_name(kind)}: {error}.") from error
    except RecursionError as error:
        raise InvalidConfigError(f"{_name(kind)}: nested too deeply.") from error


def check_ranges(config: Any) -> None:
    """Check the fields of a dataclass by their annotations, as :func:`decode` does.

    Args:
        config: A dataclass, made by its constructor.

    Raises:
        InvalidConfigError: A value is of another type or out of its range.
    """
    hints = get_type_hints(type(config), include_extras=True)
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            continue
        try:
            msgspec.convert(value, hints[field.name], dec_hook=_path)
        except msgspec.ValidationError as error:
            choices = _choices(hints[field.name])
            why = re.sub(r" - at `\$(.*)`$", "", str(error)).replace("`", "")
            valid = why.replace("Expected", "expected")
            if choices:
                valid = f"valid: {', '.join(map(str, choices))}"
            raise InvalidConfigError(
                f"{field.name} cannot be {shown(value)}; {valid}."
            ) from error


def _choices(hint: Any) -> tuple[Any, ...]:
    """Return the values of a ``Literal`` in a type; none if it has none."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    return tuple(choice for part in get_args(hint) for choice in _choices(part))


def _check_names(kind: Any, data: Any) -> None:
    """Check names, which msgspec passes over in what it makes dataclasses from.

    Raises:
        UnknownNameError: There is no field of that name.
    """
    if not (is_dataclass(kind) and isinstance(data, Mapping)):
        return
    fields = get_type_hints(kind)
    for name, value in data.items():
        if name not in fields:
            raise UnknownNameError(f"option of {_name(kind)}", name, fields)
        _check_names(fields[name], value)


def _name(kind: Any) -> str:
    return str(getattr(kind, "__name__", kind))


def _path(kind: type[Any], value: Any) -> Any:
    """Return a path from its text; nothing else is unknown to msgspec."""
    assert kind is Path
    return Path(value)
