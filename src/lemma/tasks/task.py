"""What a task is: how its table is set, and the sentences that ask for its goal."""

from collections.abc import Callable
from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.tasks.goal import Goal
from lemma.tasks.language.bank import LanguageBank
from lemma.tasks.placement import Board


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task of the suite: data, and one function that sets the table."""

    name: str
    """Registry name: ``"poke_stack"``."""
    summary: str
    """One sentence for people."""
    subtasks: int
    """Sub-tasks of the shortest plan."""
    distractors: tuple[int, int]
    """Fewest and most objects that the goal does not need."""
    arrange: Callable[[Board], Goal]
    """Puts the objects that matter on the board and says what shall become true."""
    language: LanguageBank
    """Its instructions."""
    apart: bool = False
    """Whether the robots share no region, but stand so far apart that only the stick
    bridges the gap."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        least, most = self.distractors
        if not 0 <= least <= most or self.subtasks < 1:
            raise InvalidConfigError(
                f"Task {self.name!r}: {self.subtasks} sub-tasks and {least} to {most} "
                "distractors. There must be at least one sub-task, and the range of "
                "distractors must ascend from zero or more."
            )

    @property
    def gym_id(self) -> str:
        """Gymnasium name: ``"lemma/PokeStack-v0"``."""
        words = self.name.split("_")
        return f"lemma/{''.join(word.capitalize() for word in words)}-v0"


TASKS: Registry[Task] = Registry("task")
"""Every task that can be sampled, built-in ones first."""
