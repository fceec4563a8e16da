"""The base class of trained models, and the registry of all models."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor, nn

from lemma.core.arguments import Height, Size
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.core.robot_names import robot_name
from lemma.policies.batch import PRIMITIVES, STOP, Batch, batch_of
from lemma.policies.entities import EntitySet
from lemma.policies.interfaces import PolicyInput
from lemma.scene.raster import RASTER, Raster
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask


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
    of_fixed_shape: ClassVar[bool] = False
    """Whether :meth:`loss` only computes with tensors whose shapes follow from the
    number of frames: a GPU can then do a whole step at once
    (:class:`lemma.policies.training.captured.CapturedStep`)."""
    former_names: ClassVar[Mapping[str, str]] = {}
    """Patterns of names of weights in files of earlier releases, and what takes the
    place of each."""
    former_options: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Options of parts of the model that files of earlier releases do not name, and
    their values there."""
    config: Any
    """The options; a frozen dataclass whose fields are plain data."""

    @property
    def entities(self) -> EntitySet:
        """Entities with a number in its batches: all that are known, or its choice."""
        return EntitySet.of(getattr(self.config, "entities", ()))

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return what the loss needs of texts and names, as tensors.

        It is made while the model works on the batch before, and kept in the batch.

        Args:
            batch: With labels.
        """
        return {}

    @abstractmethod
    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the terms of the loss, weighted: training minimises their sum.

        Args:
            batch: With labels, with or without what :meth:`text_tensors` returned.
        """

    @abstractmethod
    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return how good decisions are, one value a frame, (B,); more is better.

        NaN where a frame does not count, such as the pose of ``stop``.

        Args:
            batch: With labels.
        """


@dataclass(frozen=True, kw_only=True)
class MapConfig:
    """Options of models that see one map a frame."""

    cell_m: Size = RASTER.cell_m
    """Side of a cell of the map [m]."""
    floor_m: Height = RASTER.floor_m
    """Lowest height of the map [m]."""

    def raster(self, policy_input: PolicyInput) -> Raster:
        """Return where the cells of a view are."""
        rows, columns = policy_input.view.height_m.shape
        return Raster(rows, columns, self.cell_m, self.floor_m)


class MapModel(Model):
    """A model that decides by one map a frame."""

    at_once: ClassVar[int] = 32
    """Frames that are decided at once."""

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return next(self.parameters()).device

    @contextmanager
    def deciding(self) -> Iterator[None]:
        """Switch training off for a while."""
        was = self.training
        # Not without need: a model may forget what it has seen.
        if was:
            self.eval()
        try:
            with torch.inference_mode():
                yield
        finally:
            if was:
                self.train()

    def batches(
        self, inputs: Sequence[PolicyInput], sub_instructions: Sequence[str] = ()
    ) -> Iterator[Batch]:
        """Yield the inputs, and the sub-instructions to ground, in batches."""
        for start in range(0, len(inputs), self.at_once):
            rows = slice(start, start + self.at_once)
            raster = self.config.raster(inputs[start])
            texts = sub_instructions[rows]
            yield batch_of(inputs[rows], raster, texts, self.device, self.entities)


def subtask_of(numbers: Sequence[int], entities: EntitySet) -> SubTask:
    """Return a sub-task of numbers: robot, primitive, pick, place."""
    robot, primitive, pick, place = numbers
    if primitive == STOP:
        return STOP_SUBTASK
    names = entities.places
    return SubTask(
        robot_name(robot), Primitive(PRIMITIVES[primitive]), names[pick], names[place]
    )


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
