"""Policies at control level, for tests: what they answer is in their arguments."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from lemma.policies.control.interfaces import Actions, ControlInput

SMALL: dict[str, Any] = {
    "control": "joint_position",
    "control_hz": 10.0,
    "observation": "state",
}
CALLS = 3
"""After so many questions about an episode a policy has had enough."""


class Stays:
    """Keeps every joint where it is, and stops the test after a while."""

    control_options: ClassVar[dict[str, Any]] = SMALL

    def __init__(self, chunk: int = 5, says: str = "") -> None:
        self.chunk, self.says = chunk, says
        self.seen: list[ControlInput] = []

    def act(self, inputs: Sequence[ControlInput]) -> list[Any]:
        self.seen += inputs
        return [self._act(given) for given in inputs]

    def _act(self, given: ControlInput) -> Any:
        calls = (given.memory or 0) + 1
        if calls > CALLS:
            raise RuntimeError(f"{calls} calls, step {given.step}, {self.says}")
        joints = given.observation["agent_pos"].reshape(len(given.robots), 7)
        rows = np.repeat(joints[None], self.chunk, axis=0)
        return Actions(bad(rows, self.says), calls)


def bad(rows: Any, says: str) -> Any:
    """The fault of the actions, in one word."""
    wrong = {
        "nan": rows * np.nan,
        "shape": rows[:, :1],
        "bounds": rows + 100.0,
        "text": "left",
        "none": None,
        "empty": rows[:0],
    }
    return wrong.get(says, rows)
