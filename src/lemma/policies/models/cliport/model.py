"""CLIPort in a smaller version, without CLIP: pick and place poses.

After Shridhar et al., *CLIPort: What and Where Pathways for Robotic Manipulation*
(CoRL 2021), reimplemented. As in the paper, there are two streams, and the semantic one
is conditioned on the sentence; lateral connections at every level of decoding; pick by
attention; place by correlation of rotated crops around the pick with the table; softmax
over all cells and rotations. The differences make it smaller and predict gripper yaws:

- networks with a few million weights are trained from scratch;
- cells of the output are 16 and 32 mm wide, with a regression of the offset in them;
- the pick has a yaw, and the crop is rotated by it, so rotations are gripper yaws;
- features of the crop are rotated instead of the crop, so the network runs once;
- a second look around the place corrects it; this is an option, on by default.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_name
from lemma.policies.batch import PRIMITIVES, STOP, Batch, Labels
from lemma.policies.entities import BENCHMARK, EntitySet, traits_of
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.models.base import MODELS, MapModel
from lemma.policies.models.cliport.networks import (
    Attention,
    CLIPortConfig,
    PickHead,
    PlaceHead,
    Zoom,
    image_of,
    pick_cells,
    place_cells,
)
from lemma.policies.models.grid import (
    nearest_bins,
    pose_in,
    read_at,
    wrapped,
    yaw_of,
)
from lemma.policies.text.encoder import Sentences, TextConfig, TextEncoder
from lemma.scene.raster import Raster
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask

_PRIMITIVES = tuple(name for name in PRIMITIVES if name != PRIMITIVES[STOP])
_STOP_WIDTH = 128
_YAW_WEIGHT = 0.5
_NEAR_M = 0.02
_NEAR_SHARED_M = 0.06
_NEAR_PICK_YAW = math.radians(10.0)
_NEAR_PLACE_YAW = math.radians(8.0)
_LEAST_RAD = 1e-3
_MOVE = PRIMITIVES.index("move")


class Poses(NamedTuple):
    """Gripper's poses where it closes and where its motion ends: x, y [m], yaw [rad].

    Both are (B, 3). The yaws differ by at most half a turn.
    """

    pick: Tensor
    place: Tensor


class PickAndPlace(MapModel):
    """The common base of CLIPort and M-CLIPort: sentence and map to two poses."""

    # The FFTs need much memory.
    at_once = 16
    of_fixed_shape = True
    former_names: ClassVar[Mapping[str, str]] = {r"_text\.reader\.": "_text."}

    def __init__(self, config: CLIPortConfig, extra: int = 0) -> None:
        """Make the weights.

        Args:
            config: Options.
            extra: Number of further outputs of the pick head for each cell.
        """
        super().__init__()
        self.config: CLIPortConfig = config
        text = TextConfig(
            width=config.text_width,
            layers=config.text_layers,
            word_dropout=config.word_dropout,
        )
        # Separate encoders, because pick and place depend on different words.
        self.pick_text = TextEncoder(text)
        self.place_text = TextEncoder(text)
        self.pick = PickHead(config, extra)
        self.place = PlaceHead(config)
        self.zoom = Zoom(config) if config.zoom else None

    def sentences(self, batch: Batch) -> list[str]:
        """Return the sentences that the model reads."""
        raise NotImplementedError

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return the words of the sentences as numbers."""
        # Both encoders have the same vocabulary.
        words = self.pick_text.sentences.read(self.sentences(batch), self.device)
        return {"words": torch.stack(words)}

    def look(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Return the image, and the sentence's vectors for the pick and the place."""
        tensors = batch.text_tensors or self.text_tensors(batch)
        texts = Sentences(*tensors["words"])
        # Normalise, because means over many words are small and slow down training.
        to_pick, to_place = (
            F.layer_norm(encoder.pooled(texts), (self.config.text_width,))
            for encoder in (self.pick_text, self.place_text)
        )
        return image_of(batch), to_pick, to_place

    def picked(self, seen: Attention, raster: Raster) -> tuple[Tensor, Tensor]:
        """Return the best pick poses, (B, 3), and their cells, (B,)."""
        numbers = seen.logits.argmax(1, keepdim=True)
        offsets, yaws, residuals = self.pick.at(seen, numbers)
        pose = pose_in(pick_cells(raster), numbers, offsets, yaws, residuals)
        return pose, numbers[:, 0]

    def placed(
        self, image: Tensor, sentence: Tensor, pick: Tensor, raster: Raster
    ) -> Tensor:
        """Return the best place poses for pick poses, (B, 3)."""
        cells = place_cells(raster)
        fit = self.place(image, sentence, pick, raster)
        best = fit.logits.flatten(1).argmax(1, keepdim=True)
        bin_number, number = best // len(cells), best % len(cells)
        offsets, residual = self.place.at(fit, number, bin_number, pick, cells)
        xy = cells.positions(number, offsets)[:, 0]
        place = torch.cat([xy, yaw_of(bin_number, residual, self.place.bins)], 1)
        if self.zoom is not None:
            correction = self.zoom((image, sentence, fit), pick, place, raster)
            place = self.zoom.corrected(place, correction)
        # The arm takes the shorter way from one yaw to the other.
        yaw = pick[:, 2:] + wrapped(place[:, 2:] - pick[:, 2:])
        return torch.cat([place[:, :2], yaw], 1)

    def pick_losses(self, seen: Attention, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of the pick, without frames of ``stop``."""
        assert batch.labels is not None
        counts, pick, _ = counted(batch.labels)
        cells = pick_cells(batch.raster)
        numbers = cells.holding(pick[:, :2])
        chosen = F.cross_entropy(seen.logits, numbers, reduction="none")
        near = cells.around(numbers)
        offsets, yaws, residuals = self.pick.at(seen, near)
        wanted = cells.offsets(pick[:, None, :2], near)
        both, rests = nearest_bins(pick[:, 2], self.pick.bins)
        yaw = F.cross_entropy(yaws[:, 4], both[:, 0], reduction="none")
        index = both[:, None].expand(-1, near.shape[1], -1)
        residual = F.smooth_l1_loss(
            residuals.gather(2, index),
            rests[:, None].expand(index.shape),
            reduction="none",
        )
        return {
            "pick": mean_over(chosen, counts),
            "pick_offset": mean_over(_distance(offsets, wanted), counts),
            "pick_yaw": _YAW_WEIGHT * mean_over(yaw, counts),
            "pick_residual": mean_over(residual.mean((1, 2)), counts),
        }

    def place_losses(
        self, image: Tensor, sentence: Tensor, batch: Batch
    ) -> dict[str, Tensor]:
        """Return the losses of the place, given the expert's pick."""
        assert batch.labels is not None
        counts, pick, place = counted(batch.labels)
        cells = place_cells(batch.raster)
        fit = self.place(image, sentence, pick, batch.raster)
        numbers = cells.holding(place[:, :2])
        both, rests = nearest_bins(place[:, 2], self.place.bins)
        chosen = F.cross_entropy(
            fit.logits.flatten(1), both[:, 0] * len(cells) + numbers, reduction="none"
        )
        near = cells.around(numbers)
        count = near.shape[1]
        bin_numbers = both.repeat_interleave(count, 1)
        near = near.repeat(1, both.shape[1])
        offsets, residuals = self.place.at(fit, near, bin_numbers, pick, cells)
        wanted = cells.offsets(place[:, None, :2], near)
        residual = F.smooth_l1_loss(
            residuals, rests.repeat_interleave(count, 1), reduction="none"
        )
        losses = {
            "place": mean_over(chosen, counts),
            "place_offset": mean_over(_distance(offsets, wanted), counts),
            "place_residual": mean_over(residual.mean(1), counts),
        }
        if self.zoom is not None:
            again = self.zoom.loss((image, sentence, fit), pick, place, batch.raster)
            losses["place_zoom"] = mean_over(again, counts)
        return losses


class CLIPort(PickAndPlace):
    """A grounder: from a sub-instruction to poses of the gripper."""

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
        """Return the losses of pick and place, without frames of ``stop``."""
        image, to_pick, to_place = self.look(batch)
        picking = self.pick_losses(self.pick(image, to_pick), batch)
        return picking | self.place_losses(image, to_place, batch)

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return whether the poses are right; see :func:`score_poses`."""
        assert batch.labels is not None
        with self.deciding():
            return score_poses(self.poses(batch), batch.labels, batch.entities)

    def poses(self, batch: Batch) -> Poses:
        """Return the poses for each frame."""
        image, to_pick, to_place = self.look(batch)
        pick, _ = self.picked(self.pick(image, to_pick), batch.raster)
        return Poses(pick, self.placed(image, to_place, pick, batch.raster))

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        """Return each sub-task with poses; None if it has no sub-instruction."""
        texts = [_words(*pair) for pair in zip(inputs, subtasks, strict=True)]
        indices = [i for i, text in enumerate(texts) if text]
        found: list[GroundedSubTask | None] = [None] * len(texts)
        places = iter(indices)
        said = [texts[i] for i in indices]
        with self.deciding():
            for batch in self.batches([inputs[i] for i in indices], said):
                poses = self.poses(batch)
                for pick, place in zip(*map(Tensor.tolist, poses), strict=True):
                    i = next(places)
                    found[i] = grounded(subtasks[i], pick, place)
        return found


def grounded(
    subtask: SubTask, pick: Sequence[float], place: Sequence[float]
) -> GroundedSubTask:
    """Return a sub-task with poses x, y [m], yaw [rad]."""
    first, last = Pose2(*pick), Pose2(*place)
    return GroundedSubTask(subtask.robot, subtask.primitive, first, last)


def _words(policy_input: PolicyInput, subtask: SubTask) -> str:
    if subtask.primitive is Primitive.STOP or not subtask.robot:
        return ""
    try:
        return policy_input.words_for(subtask)
    except (UnknownNameError, InvalidConfigError, IndexError):
        return ""


def counted(labels: Labels) -> tuple[Tensor, Tensor, Tensor]:
    """Return whether frames have poses, (B,), and the poses, (B, 3); 0 without any."""
    counts = labels.decision[:, 1] != STOP
    return counts, labels.pick_pose.nan_to_num(), labels.place_pose.nan_to_num()


def mean_over(values: Tensor, counts: Tensor) -> Tensor:
    """Return the mean of values, (B,), over the frames that count, (B,) bool."""
    return (values * counts).sum() / counts.sum().clamp(min=1)


def _distance(offsets: Tensor, wanted: Tensor) -> Tensor:
    return F.smooth_l1_loss(offsets, wanted, reduction="none", beta=0.5).mean((1, 2))


def score_poses(
    found: Poses, labels: Labels, entities: EntitySet = BENCHMARK
) -> dict[str, Tensor]:
    """Return whether poses match the expert's, (B,) each; NaN for ``stop``.

    ``grounded`` is whether pick and place are right, for all frames and by primitive.

    A pick is right within 2 cm and 10 degrees, up to the symmetry of the grasp: half
    turns, and quarter turns for cubes; any yaw for round objects. A place is right
    within 2 cm, or within 6 cm in the shared region, where any position is valid; the
    stick also within 8 degrees.

    Args:
        found: Predicted poses.
        labels: The expert's poses.
        entities: Entities, in the order of their numbers.
    """
    counts, pick, place = counted(labels)
    _, primitive, entity, goal = labels.decision.unbind(1)
    turns = traits_of(entities, pick.device).turn_rad[entity.clamp(min=0)]
    is_stick = entity == entities.stick
    pick_m = (found.pick[:, :2] - pick[:, :2]).norm(dim=1)
    pick_yaw = _apart(found.pick[:, 2] - pick[:, 2], turns)
    place_m = (found.place[:, :2] - place[:, :2]).norm(dim=1)
    # The difference of the yaws is the rotation of the held object.
    turn = (found.place[:, 2] - found.pick[:, 2]) - (place[:, 2] - pick[:, 2])
    held = torch.where(is_stick, 2 * math.pi, turns)
    place_yaw = _apart(turn, held) + torch.where(is_stick, pick_yaw, 0.0)
    near_m = torch.where(goal == entities.shared, _NEAR_SHARED_M, _NEAR_M)
    right_pick = (pick_m < _NEAR_M) & (pick_yaw < _NEAR_PICK_YAW)
    right_place = (place_m < near_m) & (
        (primitive == _MOVE) | (place_yaw < _NEAR_PLACE_YAW)
    )
    right = (right_pick & right_place).float()
    by_primitive = {
        f"grounded_{name}": right.where(primitive == number, math.nan)
        for number, name in enumerate(PRIMITIVES)
        if number != STOP
    }
    scores = {
        **by_primitive,
        "grounded": right,
        "right_pick": right_pick.float(),
        "right_place": right_place.float(),
        "minus_pick_mm": -1000.0 * pick_m,
        "minus_place_mm": -1000.0 * place_m,
        "minus_place_deg": -torch.rad2deg(place_yaw),
    }
    return {name: value.where(counts, math.nan) for name, value in scores.items()}


def _apart(angle: Tensor, symmetry: Tensor) -> Tensor:
    """Return the distance of an angle from the nearest multiple of a symmetry [rad].

    Args:
        angle: [rad], (B,).
        symmetry: [rad], (B,); 0 for full rotational symmetry.
    """
    turn = symmetry.clamp(min=_LEAST_RAD)
    return (torch.remainder(angle + turn / 2, turn) - turn / 2).abs()


@dataclass(frozen=True)
class MCLIPortConfig(CLIPortConfig):
    """Options of :class:`MCLIPort`."""

    word_dropout: Share = 0.1
    """Share of words that are replaced by the unknown word in training."""
    robots: Depth = 2
    """Number of robots of every scene."""


class MCLIPort(PickAndPlace):
    """End-to-end CLIPort, from an instruction to robot, primitive and poses.

    The networks are CLIPort's. The pick head also predicts robot and primitive for each
    cell (paper, section V); the decision has those of the pick's cell. ``stop`` has no
    pick, so it is predicted from the features of the whole image. The policy has no
    history.
    """

    selection = "decided"

    def __init__(self, config: MCLIPortConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        config = config or MCLIPortConfig()
        super().__init__(config, config.robots + len(_PRIMITIVES))
        self.robots = config.robots
        self.stop = nn.Sequential(
            nn.Linear(self.pick.context_width, _STOP_WIDTH),
            nn.SiLU(),
            nn.Linear(_STOP_WIDTH, 1),
        )

    def sentences(self, batch: Batch) -> list[str]:
        """Return the instructions."""
        return batch.instructions

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of the poses, the robot, the primitive and ``stop``."""
        assert batch.labels is not None
        counts, pick, _ = counted(batch.labels)
        image, to_pick, to_place = self.look(batch)
        seen = self.pick(image, to_pick)
        cells = pick_cells(batch.raster)
        who, what = self._symbols(seen, cells.around(cells.holding(pick[:, :2])))
        robot, primitive = batch.labels.decision[:, :2].unbind(1)
        robot, primitive = robot.clamp(min=0), primitive.clamp(max=STOP - 1)
        stops = self.stop(seen.context).float()[:, 0]
        return {
            **self.pick_losses(seen, batch),
            **self.place_losses(image, to_place, batch),
            "robot": mean_over(_mean_entropy(who, robot), counts),
            "primitive": mean_over(_mean_entropy(what, primitive), counts),
            "stop": F.binary_cross_entropy_with_logits(stops, (~counts).float()),
        }

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return whether decisions and poses match the expert's."""
        assert batch.labels is not None
        with self.deciding():
            stop, who, what, poses = self._decide(batch)
            scores = score_poses(poses, batch.labels, batch.entities)
            robot, primitive = batch.labels.decision[:, :2].unbind(1)
            stops = primitive == STOP
            right_robot = (who == robot).float()
            right_primitive = (what == primitive).float()
            acts = right_robot * right_primitive * scores["grounded"].nan_to_num()
            decided = torch.where(stops, stop.float(), acts * ~stop)
            return {
                "decided": decided,
                "right_stop": (stop == stops).float(),
                "right_robot": right_robot.masked_fill(stops, torch.nan),
                "right_primitive": right_primitive.masked_fill(stops, torch.nan),
                **scores,
            }

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode, without names of entities."""
        found = []
        with self.deciding():
            for batch in self.batches(inputs):
                *symbols, poses = self._decide(batch)
                rows = (part.tolist() for part in (*symbols, *poses))
                found += [_decision(*row) for row in zip(*rows, strict=True)]
        return found

    def _decide(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Poses]:
        """Return whether to stop, robots and primitives, (B,) each, and poses."""
        image, to_pick, to_place = self.look(batch)
        seen = self.pick(image, to_pick)
        pick, numbers = self.picked(seen, batch.raster)
        place = self.placed(image, to_place, pick, batch.raster)
        who, what = (
            part[:, 0].argmax(-1) for part in self._symbols(seen, numbers[:, None])
        )
        return self.stop(seen.context)[:, 0] > 0.0, who, what, Poses(pick, place)

    def _symbols(self, seen: Attention, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits of robots and primitives in pick cells, (B, K, ...)."""
        read = read_at(seen.maps[:, 1:], numbers).float()
        return read[..., : self.robots], read[..., self.robots :]


def _mean_entropy(logits: Tensor, wanted: Tensor) -> Tensor:
    """Return the cross-entropy of each frame, (B,), over cells (B, K, classes)."""
    each = wanted[:, None].expand(-1, logits.shape[1])
    return F.cross_entropy(logits.transpose(1, 2), each, reduction="none").mean(1)


def _decision(
    stops: bool, robot: int, primitive: int, pick: list[float], place: list[float]
) -> Decision:
    if stops:
        return Decision(STOP_SUBTASK, None)
    subtask = SubTask(robot_name(robot), Primitive(_PRIMITIVES[primitive]))
    return Decision(subtask, grounded(subtask, pick, place))


MODELS.add("cliport", (CLIPort, CLIPortConfig))
MODELS.add("m-cliport", (MCLIPort, MCLIPortConfig))
