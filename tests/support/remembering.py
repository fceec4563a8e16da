"""A planner that remembers whom it was asked about, and raises when asked again."""

from collections.abc import Sequence

from lemma.policies.interfaces import PolicyInput
from lemma.tasks.subtask import STOP, SubTask


class Remembering:
    """Stops at once; raises if it has planned for another sentence before."""

    reads_outcomes = True

    def __init__(self) -> None:
        self.heard: list[str] = []

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        self.heard += [given.instruction for given in inputs]
        if len(set(self.heard)) > 1:
            raise RuntimeError("it remembers")
        return [STOP] * len(inputs)


class Keeping(Remembering):
    """The same, and says so."""

    keeps_state = True
