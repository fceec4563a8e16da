"""Motor commands that somebody gave by hand, given again."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lemma.core.errors import InvalidConfigError
from lemma.dataset.teleoperation import Commanded, Teleoperation
from lemma.policies.control.interfaces import Actions, ControlInput


class Recorded:
    """Repeats the commands of a file, then the last one, without looking."""

    def __init__(self, file: str) -> None:
        """Read them.

        Args:
            file: Path of an episode that was led by hand from its beginning on.

        Raises:
            LemmaError: It cannot be read, or holds more than motor commands; see
                :meth:`~lemma.dataset.teleoperation.Teleoperation.load`.
        """
        done = Teleoperation.load(Path(file))
        first = done.parts[0]
        if len(done.parts) > 1 or done.nudged or not isinstance(first, Commanded):
            raise InvalidConfigError(
                f"{file} holds more than motor commands: a policy began, or a thing "
                "was moved by hand. 'lemma replay' does all of it again."
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
