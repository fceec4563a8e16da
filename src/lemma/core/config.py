"""Dataclasses from plain data, such as JSON: every type, range and name is checked."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import msgspec

from lemma.core.errors import InvalidConfigError, LemmaError, UnknownNameError

T = TypeVar("T")

Width = Annotated[int, msgspec.Meta(ge=1, le=4096)]
"""Channels of a map, or values of a token."""
Widths = Annotated[tuple[Width, ...], msgspec.Meta(min_length=1, max_length=8)]
"""Channels of each level of a network."""
Depth = Annotated[int, msgspec.Meta(ge=1, le=64)]
"""Layers, blocks or heads."""
Count = Annotated[int, msgspec.Meta(ge=1, le=1024)]
"""Of whatever is not built of weights."""
Share = Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)]
"""Part of a whole, less than all of it."""
Deviation = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
"""Standard deviation of noise."""
Size = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
"""Of something on the table [m]."""
Height = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
"""Above the table top [m]."""
Cost = Annotated[float, msgspec.Meta(ge=0.0, le=1e3)]
"""Loss of log-probability."""
Extent = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
"""Of a part of the table [m]."""


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
