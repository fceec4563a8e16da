"""A model server of vla-eval behind the interface of policies at control level."""

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lemma.core.robot_names import robot_names
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.serve.client.vla_eval import ModelServer, ServedEpisode
from lemma.serve.protocol.faults import PolicyFailedError
from lemma.serve.protocol.vla_eval import observation

_TASK = {"name": "lemma", "suite": "lemma"}
"""What a server is told of an episode: policies are not told which task it is."""


@dataclass(frozen=True, eq=False)
class _Memory:
    """An episode that ends when nobody remembers it any more."""

    episode: ServedEpisode

    def __post_init__(self) -> None:
        weakref.finalize(self, self.episode.end, {}).atexit = False


class ModelServerPolicy:
    """Motor commands from a model server of vla-eval."""

    def __init__(
        self,
        server: ModelServer,
        options: Mapping[str, Any],
        columns: Sequence[str],
        state: Sequence[str] = ("agent_pos",),
    ) -> None:
        """Keep the connection.

        Args:
            server: Who is asked.
            options: In which environment it acts.
            columns: What each number of a robot's row means.
            state: What the state that is sent consists of, in order.
        """
        self.server = server
        self.control_options = dict(options)
        self._columns, self._state = tuple(columns), tuple(state)

    @property
    def about(self) -> dict[str, Any]:
        """What the server says of itself, and what was chosen for it."""
        return {
            **self.server.about,
            "control_options": self.control_options,
            "state": list(self._state),
        }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions | PolicyFailedError]:
        """Return the next action of each episode, or why it has none.

        Raises:
            PolicyUnreachableError: Nobody answers any more.
        """
        memories = [given.memory or self._begin(given) for given in inputs]
        answers = self.server.act(
            [memory.episode for memory in memories], [*map(self._seen, inputs)]
        )
        return [
            answer
            if isinstance(answer, PolicyFailedError)
            else Actions(answer.reshape(len(given.robots), -1), memory)
            for answer, given, memory in zip(answers, inputs, memories, strict=True)
        ]

    def close(self) -> None:
        """Hang up."""
        self.server.close()

    def _begin(self, given: ControlInput) -> _Memory:
        names = [
            f"{robot}.{column}"
            for robot in robot_names(len(given.robots))
            for column in self._columns
        ]
        return _Memory(self.server.begin(_TASK, names))

    def _seen(self, given: ControlInput) -> dict[str, Any]:
        state = np.concatenate(
            [np.ravel(given.observation[part]) for part in self._state]
        )
        pixels = given.observation.get("pixels", {})
        return observation(pixels, given.instruction, state, given.robots)
