"""The base class of trained models, and the registry of all models."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any, ClassVar, Literal

from torch import Tensor, nn

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.policies.batch import Batch
from lemma.policies.entities import EntitySet


class Model(nn.Module, ABC):
    """A network with its losses and its scores.

    A subclass has a frozen dataclass of its options, which is the one argument of its
    constructor; it is written beside the weights, as JSON.
    """

    unit: ClassVar[Literal["frame", "episode"]] = "frame"
    """Training draws single frames at random, or whole episodes, whose frames then
    follow one another in the batch."""
    selection: ClassVar[str]
    """Name of the score by which the best weights are chosen, in validation."""
    reads_outcomes: ClassVar[bool] = False
    """Whether it looks at how its sub-tasks ended; otherwise another robot tries a
    sub-task that one was refused (:class:`lemma.policies.compose.RetryingPlanner`)."""
    former_names: ClassVar[Mapping[str, str]] = {}
    """Patterns of names of weights in files of earlier releases, and what takes the
    place of each."""
    config: Any
    """The options; a frozen dataclass whose fields are plain data."""

    @property
    def entities(self) -> EntitySet:
        """Entities with a number in its batches: all that are known, or its choice."""
        return EntitySet.of(getattr(self.config, "entities", ()))

    @abstractmethod
    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the terms of the loss, weighted: training minimises their sum.

        Args:
            batch: With labels.
        """

    @abstractmethod
    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return how good decisions are, one value a frame, (B,); more is better.

        NaN where a frame does not count, such as the pose of ``stop``.

        Args:
            batch: With labels.
        """


def _check_model(name: str, record: tuple[type[Any], type[Any]]) -> None:
    """Check that the options are a dataclass with defaults.

    Raises:
        InvalidConfigError: They are not.
    """
    try:
        if is_dataclass(record[1]()):
            return
        reason = "no dataclass"
    except Exception as error:
        reason = f"not to be made without arguments ({error})"
    raise InvalidConfigError(
        f"The model {name!r} cannot be registered: {record[1].__name__}, the type of "
        f"its options, is {reason}. Use a dataclass whose fields have defaults."
    )


MODELS: Registry[tuple[type[Any], type[Any]]] = Registry(
    "model", tuple[type[Model], type[Any]], on_add=_check_model
)
"""Models by the name that ``lemma train`` knows, each with its type of options."""
