"""Named records that tasks, arms, kinds and policies are looked up in."""

import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from lemma.core.errors import InvalidConfigError, UnknownNameError

T = TypeVar("T")


class Registry(Generic[T]):
    """Named records in the order in which they were added."""

    def __init__(
        self, kind: str, on_add: Callable[[str, T], None] | None = None
    ) -> None:
        """Create an empty registry.

        Args:
            kind: What the records are, as a noun for error messages.
            on_add: Called with every name and record before it is kept; what it raises
                refuses the record.
        """
        self._kind = kind
        self._on_add = on_add
        self._records: dict[str, T] = {}
        self._added_by: dict[str, str] = {}

    def add(self, name: str, record: T, *, replace: bool = False) -> T:
        """Add a record and return it.

        A module may add a name of its own again, as when a notebook's cell is run
        twice: the record is replaced in its place, with a warning.

        Args:
            name: What it is looked up by.
            record: The record; its own ``name``, if it has one, must be the same.
            replace: Replace a record of another module, without a warning.

        Raises:
            InvalidConfigError: The name is taken, or is not the record's own.
        """
        own = getattr(record, "name", name)
        if own != name:
            raise InvalidConfigError(
                f"The {self._kind} {own!r} cannot be added as {name!r}. Use one name."
            )
        module = sys._getframe(1).f_globals.get("__name__", "")
        if name in self._records and not replace:
            if module != self._added_by[name]:
                raise InvalidConfigError(
                    f"A {self._kind} named {name!r} is already registered, by "
                    f"{self._added_by[name]}. Choose another name, or add it with "
                    "replace=True."
                )
            warnings.warn(
                f"The {self._kind} {name!r} is replaced by a new one.", stacklevel=2
            )
        if self._on_add is not None:
            self._on_add(name, record)
        self._records[name] = record
        self._added_by[name] = module
        return record

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
