"""What is asked of a planner that talks to a language model."""

from dataclasses import dataclass
from pathlib import Path

from lemma.core.errors import InvalidConfigError, LemmaError, UnknownNameError

MODES = ("record", "replay", "strict")
"""What becomes of a request that the cassette does not hold: it is asked and kept; it
is asked and not kept; it is an error."""
PERCEPTIONS = ("truth", "seen")
"""Where the text of a scene comes from: the simulation, or ReachNet's eye."""
TEAMS = ("one", "each")
"""One planner for the team, or one for each robot, with messages between them."""


class PlannerUnavailableError(LemmaError, RuntimeError):
    """Nobody answers, or nobody may be asked.

    No fault of the model: nothing is known about what it would have decided.
    """


@dataclass(frozen=True)
class ChatOptions:
    """How a language model is asked; plain data, so that other processes can ask."""

    base_url: str = ""
    """Of an OpenAI-compatible server: ``"http://127.0.0.1:8000/v1"``; empty where a
    cassette has every answer."""
    cassette: Path | None = None
    """File of requests and answers."""
    mode: str = MODES[0]
    """One of :data:`MODES`."""
    perception: str = PERCEPTIONS[0]
    """One of :data:`PERCEPTIONS`."""
    team: str = TEAMS[0]
    """One of :data:`TEAMS`."""
    pictures: bool = False
    """Whether the cameras' images are sent along."""
    tries: int = 3
    """Answers to one question, until one is a sub-task."""
    max_tokens: int = 1024
    """Of an answer."""

    def __post_init__(self) -> None:
        """Check the names and the numbers."""
        for kind, name, valid in (
            ("mode of a cassette", self.mode, MODES),
            ("perception", self.perception, PERCEPTIONS),
            ("kind of team", self.team, TEAMS),
        ):
            if name not in valid:
                raise UnknownNameError(kind, name, valid)
        for what, number in (("Tries", self.tries), ("Tokens", self.max_tokens)):
            if number < 1:
                raise InvalidConfigError(f"{what} are 1 or more, not {number}.")

    def settings(self) -> dict[str, object]:
        """Return what decides the answers; where they come from does not."""
        return {
            "perception": self.perception,
            "team": self.team,
            "pictures": self.pictures,
            "tries": self.tries,
            "max_tokens": self.max_tokens,
        }

    def words(self) -> list[str]:
        """Return the options of the command line that ask for the same.

        Of a cassette the name alone: it is shared, and may lie anywhere.
        """
        words = [f"--perception {self.perception}", f"--team {self.team}"]
        words += ["--pictures"] if self.pictures else []
        words += [f"--tries {self.tries}", f"--max-tokens {self.max_tokens}"]
        if self.cassette is not None:
            return [*words, f"--cassette {self.cassette.name}"]
        return [*words, f"--base-url {self.base_url}"]
