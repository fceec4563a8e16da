"""Motor commands that somebody gave by hand: kept in a file, and given again.

A recipe keeps sub-tasks, which are what its episodes are replayed from; motor commands
are none. So they are kept beside their instance, in its own file: whatever reads an
instance reads this, and :class:`Recorded` gives the commands again, to the bit.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import msgspec
import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.tasks.instance import Instance

KEY = "actions"
"""Under which the commands are, beside the fields of the instance."""


class _Data(TypedDict):
    control: str
    control_hz: float
    rows: list[list[list[float]]]


@dataclass(frozen=True)
class Recording:
    """What was done at a table."""

    instance: Instance
    control: str
    """Mode of the commands."""
    control_hz: float
    """How many there were a second of simulated time."""
    rows: Sequence[Any]
    """Actions, oldest first, each (robots, columns)."""

    def to_json(self) -> str:
        """Return it as a file; what reads an instance reads it too."""
        told = {
            "control": self.control,
            "control_hz": self.control_hz,
            "rows": [np.asarray(row, float).tolist() for row in self.rows],
        }
        return json.dumps({**self.instance.to_dict(), KEY: told}) + "\n"

    @classmethod
    def load(cls, path: Path) -> "Recording":
        """Read a file.

        Raises:
            InvalidConfigError: It cannot be read, or holds no commands.
            UnknownNameError: Its instance names something that does not exist.
        """
        instance = Instance.load(path)
        data = json.loads(path.read_bytes()).get(KEY)
        try:
            found = msgspec.convert(data, _Data)
        except (msgspec.ValidationError, RecursionError) as error:
            raise InvalidConfigError(
                f"{path} holds an instance, but no motor commands: {error}."
            ) from None
        rows = [np.asarray(row, float) for row in found["rows"] if row]
        if not rows or any(row.shape != rows[0].shape for row in rows):
            raise InvalidConfigError(f"{path} holds no motor commands of one shape.")
        return cls(instance, found["control"], found["control_hz"], rows)


class Recorded:
    """Gives the commands of a recording again, whatever happens; then the last one."""

    def __init__(self, file: str) -> None:
        """Read them.

        Args:
            file: Path of the recording.

        Raises:
            LemmaError: It cannot be read; see :meth:`Recording.load`.
        """
        self._recording = Recording.load(Path(file))
        self.control_options: Mapping[str, object] = {
            "control": self._recording.control,
            "control_hz": self._recording.control_hz,
            "observation": "state",
        }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next command of each episode."""
        rows = self._recording.rows
        return [Actions(rows[min(given.step, len(rows) - 1)]) for given in inputs]
