"""A typed name-to-record table: duplicates raise, unknown names get an answer."""

from collections.abc import Iterator
from typing import Generic, TypeVar

from lemma.core.errors import InvalidConfigError, UnknownNameError

T = TypeVar("T")


class Registry(Generic[T]):
    """Named records in the order in which they were added."""

    def __init__(self, kind: str) -> None:
        """Create an empty registry.

        Args:
            kind: What the records are, as a noun for error messages.
        """
        self._kind = kind
        self._records: dict[str, T] = {}

    def add(self, name: str, record: T) -> T:
        """Add a record and return it.

        Raises:
            InvalidConfigError: The name is taken.
        """
        if name in self._records:
            raise InvalidConfigError(
                f"A {self._kind} named {name!r} is already registered. "
                "Choose another name."
            )
        self._records[name] = record
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
