"""Replay of motor commands that a person gave by teleoperation."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lemma.core.errors import InvalidConfigError
from lemma.dataset.teleoperation import Commanded, Teleoperation
from lemma.policies.control.interfaces import Actions, ControlInput


class Recorded:
    """Replays the commands of a file in open loop, then repeats the last one."""

    def __init__(self, file: str) -> None:
        """Read the commands.

        Args:
            file: Path of an episode that was teleoperated from its beginning.

        Raises:
            LemmaError: The file cannot be read, or holds more than motor commands; see
                :meth:`~lemma.dataset.teleoperation.Teleoperation.load`.
        """
        done = Teleoperation.load(Path(file))
        first = done.parts[0]
        if len(done.parts) > 1 or done.nudged or not isinstance(first, Commanded):
            raise InvalidConfigError(
                f"{file} holds more than motor commands: a policy acted first, or the "
                "user moved an object. 'lemma replay' replays all of it."
            )
        self._rows = first.rows
        self.control_options: Mapping[str, object] = {
            "control": first.control,
            "control_hz": first.control_hz,
            "observation": "state",
        }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next command of each episode."""
        rows = self._rows
        return [Actions(rows[min(one.step, len(rows) - 1)]) for one in inputs]
