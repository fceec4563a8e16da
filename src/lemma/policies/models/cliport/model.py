"""CLIPort, slim and CLIP-free by default: where to pick and where to place.

After Shridhar et al., *CLIPort: What and Where Pathways for Robotic Manipulation*
(CoRL 2021), written anew. As there: two streams, of which one hears the sentence;
connections from one to the other wherever they decode; a pick by attention; a place by
correlating what lies around the pick, turned in all ways, with the table; softmax over
all cells and turns. The differences make it small and turn grippers:

- networks of a few millions of weights learn from the start; CLIP's trunk is an option;
- cells of the output are 16 and 32 mm wide, and a regression says where in them;
- the pick has a yaw, and the crop is turned by it, so that turns are gripper yaws;
- features of the crop are turned, instead of the crop: the network looks once;
- what lies around the place is seen again, to correct it; an option, on by default.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional as F

from lemma.core.arguments import (
    Count,
    Depth,
    Extent,
    Height,
    Share,
    Size,
    Width,
    Widths,
)
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.policies.batch import Batch, batch_of
from lemma.policies.interfaces import PolicyInput
from lemma.policies.models.base import MODELS, Model
from lemma.policies.models.cliport.heads import HeadsConfig, PickHead, PlaceHead
from lemma.policies.models.cliport.networks import STRIDE, image_of
from lemma.policies.models.cliport.poses import (
    Poses,
    counted,
    pick_losses,
    picks,
    place_losses,
    places,
    score_poses,
)
from lemma.policies.models.cliport.refinement import Zoom
from lemma.policies.text.encoder import TextConfig, TextEncoder
from lemma.scene.objects.stick import STICK_KIND
from lemma.scene.raster import RASTER, Raster
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_ROOM_M = 0.06


def _stick_reach_m() -> float:
    """Return how far from its grasp the stick reaches along itself [m]."""
    grasp = STICK_KIND.grasp
    assert grasp is not None
    return max(axis.end[0] for axis in STICK_KIND.shell.capsules) - grasp.at.x


_CROP_M = 2 * round(_stick_reach_m() + _ROOM_M, 2)
AT_ONCE = 16
"""Frames that are decided at once: their spectra need memory."""


@dataclass(frozen=True)
class CLIPortConfig:
    """Options of :class:`CLIPort`."""

    widths: Widths = (32, 64, 128, 224)
    """Channels at a quarter to a 32nd of the map's resolution."""
    query_widths: Widths = (32, 64, 96, 128)
    """The same of the network that sees what lies around the pick."""
    bins: Count = 12
    """Number of bins of yaw; each is refined by a residual."""
    kernel_channels: Width = 8
    """Channels that are correlated."""
    crop: Count = 128
    """Cells along a side of what is seen around the pick, and around the place."""
    crop_m: Extent = _CROP_M
    """Side of that [m]; it should hold the stick, wherever it is grasped."""
    zoom: bool = True
    """Whether to look again at the place that was found, which CLIPort does not."""
    text_width: Width = 192
    """Width of a word."""
    text_layers: Depth = 2
    """Transformer layers over the words."""
    word_dropout: Share = 0.0
    """Share of words that are unknown in training; each word of a sub-instruction
    counts."""
    cell_m: Size = RASTER.cell_m
    """Side of a cell of the map [m]."""
    floor_m: Height = RASTER.floor_m
    """Lowest height of the map [m]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("widths", "query_widths"):
            if len(getattr(self, name)) != 4:
                raise InvalidConfigError(
                    f"{name}={getattr(self, name)!r}: there are four levels. Give four "
                    "numbers of channels, such as (32, 64, 128, 224)."
                )
        if self.crop < 2 * STRIDE or self.crop % STRIDE:
            raise InvalidConfigError(
                f"crop={self.crop} is no multiple of {STRIDE}. Take 128."
            )

    def heads(self, extra_channels: int = 0) -> HeadsConfig:
        """Return the sizes of the two heads."""
        return HeadsConfig(
            widths=self.widths,
            query_widths=self.query_widths,
            sentence_width=self.text_width,
            bins=self.bins,
            kernel_channels=self.kernel_channels,
            crop=self.crop,
            crop_m=self.crop_m,
            extra_channels=extra_channels,
        )

    def raster(self, given: PolicyInput) -> Raster:
        """Return where the cells of a view are."""
        rows, columns = given.view.height_m.shape
        return Raster(rows, columns, self.cell_m, self.floor_m)


class PickAndPlace(Model):
    """The common base of CLIPort and M-CLIPort: sentence and map to two poses."""

    former_names: ClassVar[Mapping[str, str]] = {r"_text\.reader\.": "_text."}

    def __init__(self, config: CLIPortConfig, extra_channels: int = 0) -> None:
        """Make the weights.

        Args:
            config: Sizes.
            extra_channels: Further outputs of the pick head for each cell.
        """
        super().__init__()
        self.config: CLIPortConfig = config
        heads = config.heads(extra_channels)
        text = TextConfig(
            width=config.text_width,
            layers=config.text_layers,
            word_dropout=config.word_dropout,
        )
        # One each: the pick listens for other words than the place.
        self.pick_text = TextEncoder(text)
        self.place_text = TextEncoder(text)
        self.pick = PickHead(heads)
        self.place = PlaceHead(heads)
        self.zoom = Zoom(heads) if config.zoom else None

    def sentences(self, batch: Batch) -> list[str]:
        """Return the sentences that the model reads."""
        raise NotImplementedError

    def look(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Return the picture, and the sentence as read for the pick and the place."""
        texts = self.sentences(batch)
        # Means of many words are small; normalised, they have an effect sooner.
        to_pick, to_place = (
            F.layer_norm(encoder.pooled(texts), (self.config.text_width,))
            for encoder in (self.pick_text, self.place_text)
        )
        return image_of(batch), to_pick, to_place

    @contextmanager
    def deciding(self) -> Iterator[None]:
        """Switch training off for a while."""
        was = self.training
        self.eval()
        try:
            with torch.inference_mode():
                yield
        finally:
            self.train(was)

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.place.scale.device


class CLIPort(PickAndPlace):
    """Grounds a sub-instruction: poses of the gripper."""

    selection = "grounded"

    def __init__(self, config: CLIPortConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__(config or CLIPortConfig())

    def sentences(self, batch: Batch) -> list[str]:
        """Return the sub-instructions."""
        return batch.sub_instructions

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of pick and place; ``stop`` has none."""
        assert batch.labels is not None
        counts, pick, place = counted(batch.labels)
        image, to_pick, to_place = self.look(batch)
        return {
            **pick_losses(
                self.pick, self.pick(image, to_pick), pick, counts, batch.raster
            ),
            **place_losses(
                (self.place, self.zoom),
                (image, to_place),
                Poses(pick, place),
                counts,
                batch.raster,
            ),
        }

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return how near the poses come; see :func:`score_poses`."""
        assert batch.labels is not None
        with self.deciding():
            return score_poses(self.poses(batch), batch.labels, batch.entities)

    def poses(self, batch: Batch) -> Poses:
        """Return where the gripper shall go in each frame."""
        image, to_pick, to_place = self.look(batch)
        pick, _ = picks(self.pick, self.pick(image, to_pick), batch.raster)
        seen = (image, to_place)
        return Poses(pick, places(self.place, self.zoom, seen, pick, batch.raster))

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None where it cannot be put in words."""
        texts = [_words(*pair) for pair in zip(inputs, subtasks, strict=True)]
        told = [i for i, text in enumerate(texts) if text]
        found: list[GroundedSubTask | None] = [None] * len(texts)
        for start in range(0, len(told), AT_ONCE):
            rows = told[start : start + AT_ONCE]
            batch = batch_of(
                [inputs[i] for i in rows],
                self.config.raster(inputs[rows[0]]),
                [texts[i] for i in rows],
                self.device,
                self.entities,
            )
            with self.deciding():
                poses = self.poses(batch)
            for i, pick, place in zip(
                rows, poses.pick.tolist(), poses.place.tolist(), strict=True
            ):
                found[i] = grounded(subtasks[i], pick, place)
        return found


def grounded(
    subtask: SubTask, pick: Sequence[float], place: Sequence[float]
) -> GroundedSubTask:
    """Return a sub-task with poses x, y [m], yaw [rad]."""
    first, last = Pose2(*pick), Pose2(*place)
    return GroundedSubTask(subtask.robot, subtask.primitive, first, last)


def _words(given: PolicyInput, subtask: SubTask) -> str:
    if subtask.primitive is Primitive.STOP or not subtask.robot:
        return ""
    try:
        return given.words_for(subtask)
    except (UnknownNameError, InvalidConfigError, IndexError):
        return ""


MODELS.add("cliport", (CLIPort, CLIPortConfig))
