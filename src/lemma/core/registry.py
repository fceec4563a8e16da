"""Named records that tasks, arms, kinds and policies are looked up in.

A record is checked when it is added: its name, its type, the types of its fields if it
is a dataclass, and what its registry asks for besides.
"""

import re
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from inspect import signature
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Generic, Literal, NoReturn, TypeVar, Union, get_args, get_origin

from lemma.core.errors import InvalidConfigError, UnknownNameError, shown

T = TypeVar("T")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
"""Names stand in command lines, in lists with commas and in file names."""


class Registry(Generic[T]):
    """Named records in the order in which they were added."""

    def __init__(
        self,
        kind: str,
        record_type: Any,
        on_add: Callable[[str, T], None] | None = None,
    ) -> None:
        """Create an empty registry.

        Args:
            kind: Noun for the records, for error messages.
            record_type: Type of the records, as in an annotation: a class, or
                ``Callable[[int, int], Renderer]``.
            on_add: Called with every name and record before it is kept; an exception
                refuses the record.
        """
        self._kind = kind
        self._type = record_type
        self._on_add = on_add
        self._records: dict[str, T] = {}
        self._added_by: dict[str, str] = {}

    def add(
        self, name: str, record: T, *, replace: bool = False, module: str | None = None
    ) -> T:
        """Add a record and return it.

        A module may add a name of its own again, as when a notebook's cell is run
        twice: the record is replaced in its place, with a warning.

        Args:
            name: Name to look the record up by.
            record: The record; its own ``name``, if it has one, must be the same.
            replace: Replace a record of another module, without a warning.
            module: Module that the name belongs to; the caller's if None.

        Raises:
            InvalidConfigError: The name is taken, is not the record's own or cannot be
                a name, or the record is of another type.
        """
        self._check(name, record)
        own = getattr(record, "name", name)
        if own != name:
            raise InvalidConfigError(
                f"The {self._kind} {own!r} cannot be added as {name!r}. Use one name."
            )
        # A decorator that says whose a name is stands between.
        level = 2 if module is None else 3
        module = calling_module() if module is None else module
        if name in self._records and not replace:
            if module != self._added_by[name]:
                raise InvalidConfigError(
                    f"A {self._kind} named {name!r} is already registered, by "
                    f"{self._added_by[name]}. Choose another name, or add it with "
                    "replace=True."
                )
            warnings.warn(
                f"The {self._kind} {name!r} is replaced by a new one.", stacklevel=level
            )
        if self._on_add is not None:
            self._on_add(name, record)
        self._records[name] = record
        self._added_by[name] = module
        return record

    def _check(self, name: object, record: object) -> None:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InvalidConfigError(
                f"The name of a {self._kind} cannot be {shown(name)}. Use letters, "
                "digits, underscores and hyphens."
            )
        if not fits(record, self._type):
            _refuse(self._kind, name, "the record", record, self._type)
        check_fields(self._kind, name, record)

    def __getitem__(self, name: str) -> T:
        """Return the record called ``name``.

        Raises:
            UnknownNameError: No such record; the message lists the valid names.
        """
        try:
            return self._records[name]
        except (KeyError, TypeError):
            raise UnknownNameError(self._kind, name, self._records) from None

    def __contains__(self, name: object) -> bool:
        """Whether a record is called ``name``."""
        return name in self._records

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, in the order of registration."""
        return iter(self._records)

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self._records)


def calling_module() -> str:
    """Return the module from which the function that asks was called."""
    name: str = sys._getframe(2).f_globals.get("__name__", "")
    return name


def check_fields(kind: str, name: str, record: Any) -> None:
    """Check the types of a record's fields, if it is a dataclass.

    Args:
        kind: Noun for the records, for the message.
        name: Name of the record.
        record: The record.

    Raises:
        InvalidConfigError: A field is of another type than its annotation.
    """
    if is_dataclass(record) and not isinstance(record, type):
        for field in fields(record):
            value = getattr(record, field.name)
            if not fits(value, field.type):
                _refuse(kind, name, field.name, value, field.type)


def _refuse(kind: str, name: str, part: str, value: object, hint: Any) -> NoReturn:
    raise InvalidConfigError(
        f"The {kind} {name!r} cannot be registered: {part} is {shown(value)}, and must "
        f"be {_described(hint)}."
    )


def takes(function: object, count: int) -> bool:
    """Whether something can be called with so many arguments by position."""
    if not callable(function):
        return False
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:
        return True  # some built-in functions do not say what they take
    return True


def fits(value: object, hint: Any) -> bool:
    """Whether a value is of an annotated type, as far as that can be seen.

    Args:
        value: Anything; lists stand for tuples, and NumPy's numbers for Python's.
        hint: A class, or a generic type, a union or a ``Literal`` of some.
    """
    origin, args = get_origin(hint), get_args(hint)
    if hint is Any:
        return True
    if hint is None or hint is NoneType:
        return value is None
    if origin in (Union, UnionType):
        return any(fits(value, each) for each in args)
    if origin is Literal:
        return value in args
    if origin is Callable:
        known = bool(args) and isinstance(args[0], list)
        return takes(value, len(args[0])) if known else callable(value)
    if origin is type:
        named = args[0] is not Any and isinstance(args[0], type)
        return isinstance(value, type) and (not named or issubclass(value, args[0]))
    if origin is tuple:
        return _fits_tuple(value, args)
    if hint in (int, float):
        kind = Integral if hint is int else Real
        return isinstance(value, kind) and not isinstance(value, bool)
    kind = origin or hint
    return not isinstance(kind, type) or isinstance(value, kind)


def _fits_tuple(value: object, args: tuple[Any, ...]) -> bool:
    if not isinstance(value, tuple | list):
        return False
    hints = args[:1] * len(value) if args[-1] is ... else args
    return len(value) == len(hints) and all(map(fits, value, hints))


def _described(hint: Any) -> str:
    if get_origin(hint) is Callable and get_args(hint):
        count = len(get_args(hint)[0])
        return f"callable with {count} argument{'s' * (count != 1)}"
    name = hint.__name__ if isinstance(hint, type) else str(hint)
    return re.sub(r"\b[a-z_]+(\.[a-z_]+)*\.(?=\w)", "", name)
