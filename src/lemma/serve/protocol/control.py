"""Control level over the wire: observations and actions as messages, and back."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError
from lemma.serve.protocol.messages import Array, ControlMessage


def written(given: ControlInput, episode: int) -> ControlMessage:
    """Return what a policy is given as a message.

    Args:
        given: It; its memory stays where the policy is.
        episode: Number of the episode on this connection.
    """
    return ControlMessage(
        episode=episode,
        step=given.step,
        time_s=given.time_s,
        instruction=given.instruction,
        robots=list(given.robots),
        arrays=dict(_flat(given.observation)),
        cameras=dict(given.cameras),
    )


def read(message: ControlMessage, memory: Any) -> ControlInput:
    """Return what a message means.

    Args:
        message: The message.
        memory: What the policy remembers of its episode.

    Raises:
        ProtocolError: An array is damaged.
    """
    observation: dict[str, Any] = {}
    for path, array in message.arrays.items():
        *groups, name = path.split("/")
        place = observation
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = array.read_any(path)
    return ControlInput(
        instruction=message.instruction,
        robots=tuple(message.robots),
        observation=observation,
        cameras=message.cameras,
        step=message.step,
        time_s=message.time_s,
        memory=memory,
    )


def sent(answer: object) -> Array:
    """Return an answer's actions as a message.

    Raises:
        PolicyFailedError: They are no array of numbers.
    """
    rows = answer.rows if isinstance(answer, Actions) else answer
    try:
        return Array.of(np.asarray(rows, np.float64), "float64")
    except (TypeError, ValueError) as error:
        raise PolicyFailedError(
            FaultKind.MALFORMED, f"The actions are no array of numbers: {error}."
        ) from error


def _flat(observation: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Array]]:
    found = []
    for name, value in observation.items():
        if isinstance(value, Mapping):
            found += _flat(value, f"{prefix}{name}/")
        else:
            array = np.asarray(value)
            found.append((prefix + name, Array.of(array, array.dtype.name)))
    return found
