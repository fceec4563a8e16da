"""The base class of trained models, and the registry of all models."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from typing import Any, ClassVar, Literal, Self

import torch
from torch import Tensor, nn

from lemma.core.arguments import Height, Size
from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.core.robot_names import robot_name
from lemma.policies.batch import PRIMITIVES, STOP, Batch, batch_of
from lemma.policies.entities import EntitySet
from lemma.policies.interfaces import PolicyInput
from lemma.policies.models.view_cache import ViewCache
from lemma.policies.text.lessons import Lessons
from lemma.scene.raster import RASTER, Raster
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask


class Model(nn.Module, ABC):
    """A network with its losses and scores.

    The only argument of a subclass's constructor is a frozen dataclass of options,
    which is written into the file of weights as JSON.
    """

    unit: ClassVar[Literal["frame", "episode"]] = "frame"
    """Training draws single frames, or whole episodes, whose frames are consecutive in
    the batch."""
    selection: ClassVar[str]
    """Name of the validation score that selects the best weights."""
    reads_outcomes: ClassVar[bool] = False
    """Whether the model reads outcomes; otherwise a refused sub-task goes to another
    robot (:class:`lemma.policies.compose.RetryingPlanner`)."""
    of_fixed_shape: ClassVar[bool] = False
    """Whether all tensor shapes in :meth:`loss` follow from the number of frames, so
    that a GPU can run a step as one graph
    (:class:`lemma.policies.training.captured.CapturedStep`)."""
    of_any_team: ClassVar[bool] = False
    """Whether batches may have teams of different sizes."""
    reads_places: ClassVar[bool] = False
    """Whether it reads a frame's sentence with the scene in that frame, so that
    sentences may name things by their places in it."""
    former_names: ClassVar[Mapping[str, str]] = {}
    """Patterns of names of weights in files of earlier releases, and the replacement of
    each."""
    former_options: ClassVar[Mapping[str, Any]] = {}
    """Options that files of earlier releases lack, with the values of these releases;
    for a part of the model, its name and a mapping of its options."""
    config: Any
    """The options; a frozen dataclass whose fields are plain data."""

    @property
    def entities(self) -> EntitySet:
        """Entities of its batches: those in its options, or all registered ones."""
        return EntitySet.of(getattr(self.config, "entities", ()))

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return texts and names as tensors for the loss, by name.

        The loader calls it in another thread and stores the result in the batch.

        Args:
            batch: Batch with labels.
        """
        return {}

    def lessons(self, frames: int) -> Lessons | None:
        """Return the draws of sentences for the reader alone; None if it has none.

        Args:
            frames: Number of frames in a batch.
        """
        return None

    @abstractmethod
    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the weighted terms of the loss; training minimises their sum.

        Args:
            batch: Batch with labels, with or without ``text_tensors``.
        """

    @abstractmethod
    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return scores of the decisions by name, one value per frame, (B,).

        Larger is better. A frame without the score has NaN, such as for the pose of
        ``stop``.

        Args:
            batch: Batch with labels.
        """


@dataclass(frozen=True, kw_only=True)
class MapConfig:
    """Options of models whose input is one map per frame."""

    cell_m: Size = RASTER.cell_m
    """Side of a cell of the map [m]."""
    floor_m: Height = RASTER.floor_m
    """Lowest height of the map [m]."""

    def raster(self, policy_input: PolicyInput) -> Raster:
        """Return the raster of a view's map."""
        rows, columns = policy_input.view.height_m.shape
        return Raster(rows, columns, self.cell_m, self.floor_m)


class MapModel(Model):
    """A model whose input is one map per frame."""

    at_once: ClassVar[int] = 32
    """Largest number of frames in a batch at inference."""

    def train(self, mode: bool = True) -> Self:
        """Switch between training and evaluation mode, and clear caches of views."""
        for value in vars(self).values():
            if isinstance(value, ViewCache):
                value.clear()
        return super().train(mode)

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.parameters()).device

    @contextmanager
    def deciding(self) -> Iterator[None]:
        """Evaluation mode without gradients within the context."""
        was = self.training
        # Only after training mode: a switch clears caches.
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
        """Yield inputs, with sub-instructions to ground if any, in batches."""
        for start in range(0, len(inputs), self.at_once):
            rows = slice(start, start + self.at_once)
            raster = self.config.raster(inputs[start])
            texts = sub_instructions[rows]
            yield batch_of(inputs[rows], raster, texts, self.device, self.entities)


def subtask_of(numbers: Sequence[int], entities: EntitySet) -> SubTask:
    """Return the sub-task of four numbers: robot, primitive, pick, place."""
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
"""Models by their names in ``lemma train``, each with its type of options."""
