"""Registries: named records of tasks, arms, kinds of objects and policies.

Adding a record checks its name, its type, the types of its fields if it is a dataclass,
and further conditions of the registry.
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
"""Pattern of names that are valid in commands, in lists with commas and in file names.
"""


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
            on_add: Called with each name and record before the record is stored; an
                exception prevents that.
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

        If a module adds the same name again, as when a notebook's cell is run twice,
        the new record takes the place of the old one, with a warning.

        Args:
            name: Name of the record.
            record: The record; if it has a field ``name``, that must be equal.
            replace: Replace also a record of another module, without a warning.
            module: Module that adds the record; the caller's if None.

        Raises:
            InvalidConfigError: The name is taken, is not the record's own or is
                invalid, or the record has a wrong type.
        """
        self._check(name, record)
        own = getattr(record, "name", name)
        if own != name:
            raise InvalidConfigError(
                f"The {self._kind} {own!r} cannot be added as {name!r}. Use one name."
            )
        # A decorator that passes ``module`` is one more level on the stack.
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
        """Return whether there is a record called ``name``."""
        return name in self._records

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, in the order of registration."""
        return iter(self._records)

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self._records)


def calling_module() -> str:
    """Return the module that called the caller of this function."""
    name: str = sys._getframe(2).f_globals.get("__name__", "")
    return name


def check_fields(kind: str, name: str, record: Any) -> None:
    """Check the types of a record's fields, if it is a dataclass.

    Args:
        kind: Noun for the records, for the message.
        name: Name of the record.
        record: The record.

    Raises:
        InvalidConfigError: The type of a field does not match its annotation.
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
    """Return whether an object can be called with ``count`` positional arguments."""
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
    """Return whether a value matches an annotation, as far as that can be checked.

    Args:
        value: Any value; lists match tuples, and NumPy's numbers match Python's.
        hint: A class, or a generic type, a union or a ``Literal``.
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
