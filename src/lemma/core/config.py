"""Dataclasses from plain data, such as JSON."""

from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from lemma.core.errors import InvalidConfigError, UnknownNameError


def decode(kind: type[Any], data: Any) -> Any:
    """Return a value of a type from plain data, such as JSON.

    Dataclasses, tuples, paths, optional and literal values are understood.

    Raises:
        UnknownNameError: A field has a name that is not there.
        InvalidConfigError: A value is of another type.
    """
    origin = get_origin(kind)
    if origin is Annotated:
        return decode(get_args(kind)[0], data)
    if origin in (Union, UnionType):
        if data is None and NoneType in get_args(kind):
            return None
        choices = [arg for arg in get_args(kind) if arg is not NoneType]
        return decode(choices[0], data)
    if origin is Literal:
        if data not in get_args(kind):
            raise UnknownNameError("value", data, map(str, get_args(kind)))
        return data
    if origin is tuple:
        first, *others = get_args(kind)
        repeated = others == [Ellipsis]
        kinds = [first] * len(data) if repeated else [first, *others]
        return tuple(decode(k, value) for k, value in zip(kinds, data, strict=True))
    if hasattr(kind, "__dataclass_fields__"):
        return _decode_fields(kind, data)
    return _decode_plain(kind, data)


def _decode_fields(kind: type[Any], data: Any) -> Any:
    hints = get_type_hints(kind, include_extras=True)
    for name in data:
        if name not in hints:
            raise UnknownNameError(f"option of {kind.__name__}", name, hints)
    values = {name: decode(hints[name], value) for name, value in data.items()}
    missing = [
        f.name
        for f in fields(kind)
        if f.name not in values
        and f.default is MISSING
        and f.default_factory is MISSING
    ]
    if missing:
        raise InvalidConfigError(f"{kind.__name__} lacks {', '.join(missing)}.")
    return kind(**values)


def _decode_plain(kind: type[Any], data: Any) -> Any:
    if kind is Path:
        return Path(data)
    if kind is float and type(data) in (int, float):
        return float(data)
    if kind in (bool, int, str) and type(data) is not kind:
        raise InvalidConfigError(f"{data!r} is no {kind.__name__}.")
    return data
