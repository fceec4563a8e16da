"""Checks of arguments: numbers, names and dataclasses."""

import contextlib
import math
import operator
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from ipaddress import ip_address
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
"""Number of channels of a map, or of components of a token."""
Widths = Annotated[tuple[Width, ...], msgspec.Meta(min_length=1, max_length=8)]
"""Number of channels of each level of a network."""
Depth = Annotated[int, msgspec.Meta(ge=1, le=64)]
"""Number of layers, blocks or heads."""
Count = Annotated[int, msgspec.Meta(ge=1, le=1024)]
"""A number of items without weights."""
Share = Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)]
"""A fraction in [0, 1)."""
Ratio = Annotated[float, msgspec.Meta(ge=0.0, le=16.0)]
"""Number of items per item of another kind."""
Deviation = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
"""Standard deviation of noise."""
Size = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
"""Size of an object on the table [m]."""
Height = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
"""Height above the table top [m]."""
Cost = Annotated[float, msgspec.Meta(ge=0.0, le=1e3)]
"""Penalty on log-probabilities."""
Temperature = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]
"""Divisor of log-probabilities."""
Extent = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
"""Extent of a part of the table [m]."""


def whole(
    name: str, value: object, low: int | None = None, high: int | None = None
) -> int:
    """Return a value as an integer within bounds.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's integers are valid, booleans are not.
        low: Smallest valid value.
        high: Largest valid value.

    Raises:
        InvalidConfigError: The value is no integer, or out of bounds.
    """
    is_index = isinstance(value, SupportsIndex) and not isinstance(value, bool)
    try:
        number = operator.index(value) if is_index else None  # type: ignore[arg-type]
    except TypeError:
        # Arrays have ``__index__``, but only those with a single integer are valid.
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
    """Return a value as a finite float within bounds.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's numbers are valid, booleans are not.
        low: Smallest valid value.
        high: Largest valid value.

    Raises:
        InvalidConfigError: The value is no finite number, or out of bounds.
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
    """Return a value as a boolean.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument; NumPy's booleans are valid, numbers are not.

    Raises:
        InvalidConfigError: The value is no boolean.
    """
    if not isinstance(value, bool | np.bool_):
        raise InvalidConfigError(
            f"{name}={shown(value)} is impossible. It must be True or False."
        )
    return bool(value)


def known(kind: str, name: object, valid: Iterable[str]) -> str:
    """Return a name after checking that it is valid.

    Args:
        kind: Noun for what the name denotes, for the message.
        name: The name to check.
        valid: All valid names.

    Raises:
        UnknownNameError: The name is not valid.
    """
    names = tuple(valid)
    if not isinstance(name, str) or name not in names:
        raise UnknownNameError(kind, name, names)
    return name


def secret_of(variable: str) -> str:
    """Return the secret in an environment variable, for an HTTP header.

    Args:
        variable: Name of the variable.

    Returns:
        The secret; empty if the variable is not set.

    Raises:
        InvalidConfigError: The secret contains characters that a header cannot have.
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
    """Check that an address has no user name, query, fragment or parameters.

    Args:
        url: The address; the message does not show it.
        whose: Owner of the address, such as ``"a chat server"``.
        advice: A sentence on the right place of the secret.

    Raises:
        InvalidConfigError: The address has one of them.
    """
    if any(mark in url for mark in "@?#;"):
        raise InvalidConfigError(
            f"The address of {whose} holds no password and no key, since results name "
            f"it: remove the parts with @, ?, # or a semicolon. {advice}"
        )


def without_passwords(text: str) -> str:
    """Return a text with user names and passwords removed from addresses."""
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
    """Create a dataclass from plain data, such as JSON.

    Types are strict: the text ``"1"`` is no number. Ranges are those of the fields'
    annotations.

    Args:
        kind: The dataclass; its fields may be dataclasses, too.
        data: A mapping with values of its fields.

    Raises:
        UnknownNameError: There is no field of that name.
        InvalidConfigError: A value has a wrong type or is out of range, or a field
            without default is missing.
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


def check_ranges(config: Any, prefix: str = "") -> None:
    """Check the fields of a dataclass by their annotations, as :func:`decode` does.

    Args:
        config: The dataclass instance; its fields may be dataclasses, too.
        prefix: Text before the names of its fields in messages.

    Raises:
        InvalidConfigError: A value has a wrong type or is out of range.
    """
    hints = get_type_hints(type(config), include_extras=True)
    for field in fields(config):
        value = getattr(config, field.name)
        name = prefix + field.name
        if is_dataclass(value):
            check_ranges(value, f"{name}.")
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
                f"{name} cannot be {shown(value)}; {valid}."
            ) from error


def _choices(hint: Any) -> tuple[Any, ...]:
    """Return the values of all ``Literal`` parts of a type."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    return tuple(choice for part in get_args(hint) for choice in _choices(part))


def _check_names(kind: Any, data: Any) -> None:
    """Check names of fields; msgspec ignores unknown ones.

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
    """Return a path from its text; all other types are known to msgspec."""
    assert kind is Path
    return Path(value)


def is_loopback(host: str | None) -> bool:
    """Return whether a host is ``localhost`` or an address of this machine itself."""
    try:
        return host == "localhost" or ip_address(host or "").is_loopback
    except ValueError:
        return False
