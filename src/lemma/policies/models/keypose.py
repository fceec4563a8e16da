"""KeyPose: the next key pose of a gripper from the map, joints and a sentence.

After PerAct (Shridhar et al., 2022) and RVT (Goyal et al., 2023), reimplemented for
top-down maps. The position where a hand closes, opens or pushes next is a cell of the
map and an offset in it. The features of that cell predict height, yaw, robot and kind
of the key pose. Waypoints of the control mode ``ee_waypoint`` lead to it, see
:mod:`lemma.env.control.key_poses`; then the policy predicts the next one.

One network has color and height as input. The sentence, the joints of the arms and
their grasps scale and shift its features at every level (FiLM).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Count, Depth, Share, Width, Widths
from lemma.env.control.key_poses import KINDS, KeyPose
from lemma.env.view import View
from lemma.policies.batch import Batch
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.control.moving import KEY_POSE_OPTIONS, Moving
from lemma.policies.interfaces import PolicyInput
from lemma.policies.layers import Network, ResidualBlock, upsample_to
from lemma.policies.models.base import MODELS, MapConfig, MapModel
from lemma.policies.models.cliport.networks import (
    FINER,
    IMAGE_CHANNELS,
    Encoder,
    FiLM,
    image_of,
    pick_cells,
    reader,
)
from lemma.policies.models.grid import nearest_bins, pose_in, read_finer, wrapped
from lemma.policies.text.encoder import Sentences, TextConfig, TextEncoder
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.raster import Raster

_LOUDNESS = 2.0
_ROBOT_NUMBERS = 8
"""Inputs per robot: six joint angles, opening, and whether it holds an object."""
_HEIGHT_UNIT_M = 0.05
_YAW_WEIGHT = 0.5
_NEAR_M, _NEAR_HEIGHT_M, _NEAR_RAD = 0.02, 0.012, math.radians(12.0)


@dataclass(frozen=True)
class KeyPoseConfig(MapConfig):
    """Options of :class:`KeyPoseModel`."""

    widths: Widths = (64, 96, 160, 256)
    """Channels at 1/4, 1/8, 1/16 and 1/32 of the map's resolution."""
    bins: Count = 24
    """Number of bins of yaw, each with a residual."""
    state_width: Width = 64
    """Width of the embedding of the arms' state."""
    text_width: Width = 192
    """Width of a word."""
    text_layers: Depth = 2
    """Transformer layers over the words."""
    word_dropout: Share = 0.05
    """Share of words that are replaced by the unknown word in training."""
    robots: Depth = 2
    """Number of robots of every scene."""


class _Decoder(Network):
    """Decodes to 1/4 of the resolution, conditioned on a vector."""

    def __init__(self, widths: Sequence[int], vector_width: int) -> None:
        super().__init__()
        self.tuned = nn.ModuleList(FiLM(vector_width, w, _LOUDNESS) for w in widths)
        self.deep = ResidualBlock(widths[-1], widths[-1])
        self.coarse, self.skips = nn.ModuleList(), nn.ModuleList()
        self.blocks = nn.ModuleList()
        for fine, coarse in pairwise(widths):
            self.coarse.append(nn.Conv2d(coarse, fine, 1, bias=False))
            self.skips.append(nn.Conv2d(fine, fine, 1))
            self.blocks.append(ResidualBlock(fine, fine))

    def forward(self, levels: list[Tensor], vector: Tensor) -> tuple[Tensor, Tensor]:
        x = self.deep(self.tuned[-1](levels[-1], vector))
        context = x.mean((2, 3))
        for i in reversed(range(len(self.blocks))):
            up = upsample_to(self.coarse[i](x), levels[i]) + self.skips[i](levels[i])
            x = self.blocks[i](self.tuned[i](up, vector))
        return x, context


@dataclass(frozen=True)
class _Seen:
    logits: Tensor
    """(B, cells), float32."""
    features: Tensor
    """(B, C, rows, columns)."""
    vector: Tensor
    """(B, D)."""


@dataclass(frozen=True)
class _CellPredictions:
    """Predictions for some cells, (B, K, ...), float32."""

    offsets: Tensor
    height: Tensor
    yaws: Tensor
    residuals: Tensor
    robots: Tensor
    kinds: Tensor


class KeyPoseModel(MapModel):
    """Predicts the next key pose, and is a policy at control level."""

    # Poses are continuous, and their last bits depend on the size of a batch.
    at_once = 1
    selection = "decided"
    of_fixed_shape = True
    control_options: ClassVar[Mapping[str, object]] = {
        **KEY_POSE_OPTIONS,
        "observation": "map",
    }

    def __init__(self, config: KeyPoseConfig | None = None) -> None:
        """Make the weights.

        Args:
            config: Options; the defaults if None.
        """
        super().__init__()
        self.config: KeyPoseConfig = config or KeyPoseConfig()
        config = self.config
        self.text = TextEncoder(
            TextConfig(
                width=config.text_width,
                layers=config.text_layers,
                word_dropout=config.word_dropout,
            )
        )
        self.state = nn.Sequential(
            nn.Linear(config.robots * _ROBOT_NUMBERS, config.state_width),
            nn.SiLU(),
            nn.Linear(config.state_width, config.state_width),
        )
        vector = config.text_width + config.state_width
        self.encoder = Encoder(IMAGE_CHANNELS, config.widths)
        self.decoder = _Decoder(config.widths, vector)
        width = config.widths[0]
        self.heat = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(width, FINER**2, 1),
        )
        self._outputs = [2, 1, config.bins, config.bins, config.robots, len(KINDS)]
        inputs = width + FINER**2 + config.widths[-1] + vector
        self.read = reader(inputs, sum(self._outputs))

    def text_tensors(self, batch: Batch) -> dict[str, Tensor]:
        """Return the words of the instructions as numbers."""
        words = self.text.sentences.read(batch.instructions, self.device)
        return {"words": torch.stack(words)}

    def look(self, batch: Batch) -> _Seen:
        """Return logits and features of the map, conditioned on the sentence."""
        tensors = batch.text_tensors or self.text_tensors(batch)
        words = Sentences(*tensors["words"])
        sentence = F.layer_norm(self.text.pooled(words), (self.config.text_width,))
        vector = torch.cat([sentence, self.state(_state_of(batch))], 1)
        image = image_of(batch).contiguous(memory_format=torch.channels_last)
        features, context = self.decoder(self.encoder(image), vector)
        maps = F.pixel_shuffle(self.heat(features), FINER)
        known = torch.cat([context, vector.to(context.dtype)], 1)
        return _Seen(maps.flatten(1).float(), features, known)

    def at(self, seen: _Seen, numbers: Tensor, raster: Raster) -> _CellPredictions:
        """Return the predictions for some cells, (B, K)."""
        columns = pick_cells(raster).columns
        read = read_finer(seen.features, numbers, columns, FINER)
        vector = seen.vector[:, None].expand(-1, numbers.shape[1], -1)
        found = self.read(torch.cat([read, vector.to(read.dtype)], -1)).float()
        return _CellPredictions(*found.split(self._outputs, -1))

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the losses of the cell and of the predictions for it."""
        pose, kind, height_m, robot = _labels(batch)
        seen = self.look(batch)
        cells = pick_cells(batch.raster)
        numbers = cells.holding(pose[:, :2])
        near = cells.around(numbers)
        predicted = self.at(seen, near, batch.raster)
        wanted = cells.offsets(pose[:, None, :2], near)
        both, rests = nearest_bins(pose[:, 2], self.config.bins)
        count = near.shape[1]
        index = both[:, None].expand(-1, count, -1)
        residuals = predicted.residuals.gather(2, index)
        height = (height_m / _HEIGHT_UNIT_M)[:, None, None].expand_as(predicted.height)

        def choice(logits: Tensor, right: Tensor) -> Tensor:
            each = right[:, None].expand(-1, count)
            return F.cross_entropy(logits.flatten(0, 1), each.flatten())

        return {
            "cell": F.cross_entropy(seen.logits, numbers),
            "offset": F.smooth_l1_loss(predicted.offsets, wanted, beta=0.5),
            "height": F.smooth_l1_loss(predicted.height, height, beta=0.1),
            "yaw": _YAW_WEIGHT * choice(predicted.yaws, both[:, 0]),
            "residual": F.smooth_l1_loss(
                residuals, rests[:, None].expand_as(residuals)
            ),
            "robot": choice(predicted.robots, robot),
            "kind": choice(predicted.kinds, kind),
        }

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return whether key poses match the expert's, (B,) each.

        ``decided``: robot and kind are equal, and the gripper is within 2 cm
        horizontally and 12 mm vertically.
        """
        pose, kind, height_m, robot = _labels(batch)
        with self.deciding():
            found, what, z, who = self.decide(batch)
        near_m = (found[:, :2] - pose[:, :2]).norm(dim=1)
        high_m = (z - height_m).abs()
        near, high = near_m < _NEAR_M, high_m < _NEAR_HEIGHT_M
        # A cube is symmetric under quarter turns.
        turn = wrapped((found[:, 2] - pose[:, 2]) * 4.0).abs() / 4.0
        right_kind, right_robot = what == kind, who == robot
        decided = near & high & right_kind & right_robot
        scores: dict[str, Tensor] = {
            "decided": decided,
            "near": near,
            "right_height": high,
            "right_yaw": turn < _NEAR_RAD,
            "right_kind": right_kind,
            "right_robot": right_robot,
        }
        scores = {name: value.float() for name, value in scores.items()}
        for number in sorted(set(kind.tolist())):
            name = f"decided_{KINDS[number]}"
            scores[name] = scores["decided"].where(kind == number, math.nan)
        scores["minus_mm"] = -1000.0 * near_m
        return scores

    def decide(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return poses (B, 3), kinds (B,), heights (B,) [m] and robots (B,)."""
        seen = self.look(batch)
        numbers = seen.logits.argmax(1, keepdim=True)
        predicted = self.at(seen, numbers, batch.raster)
        in_cell = predicted.offsets, predicted.yaws, predicted.residuals
        return (
            pose_in(pick_cells(batch.raster), numbers, *in_cell),
            predicted.kinds[:, 0].argmax(-1),
            predicted.height[:, 0, 0] * _HEIGHT_UNIT_M,
            predicted.robots[:, 0].argmax(-1),
        )

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return the next waypoints of each episode."""
        moving = [
            Moving.of(control_input, control_input.memory) for control_input in inputs
        ]
        resting = [i for i, one in enumerate(moving) if one.rows is None]
        seen = [_seen_by(inputs[i]) for i in resting]
        found: list[tuple[Any, ...]] = []
        with self.deciding():
            for batch in self.batches(seen):
                parts = (part.tolist() for part in self.decide(batch))
                found += zip(*parts, strict=True)
        for i, ((x, y, yaw), kind, z, robot) in zip(resting, found, strict=True):
            moving[i] = moving[i].towards(KeyPose(robot, KINDS[kind], x, y, z, yaw))
        return [one.actions(one.progress) for one in moving]


def _seen_by(control_input: ControlInput) -> PolicyInput:
    seen = control_input.observation
    joints, maps = np.reshape(seen["agent_pos"], (-1, 7)), seen["map"]
    fused = maps["rgb"], maps["height_m"], maps["coverage"]
    view = View(*fused, joints[:, :6], joints[:, 6])
    return PolicyInput(control_input.instruction, control_input.robots, view)


def _state_of(batch: Batch) -> Tensor:
    """Return joint angles, openings and whether hands hold an object, (B, R * 8)."""
    wide = batch.opening_m / FINGER_OPENING_M
    holds = ((wide > 0.1) & (wide < 0.9)).float()
    each = torch.cat([batch.joints / math.pi, wide[..., None], holds[..., None]], -1)
    return each.flatten(1)


def _labels(batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return poses (B, 3), kinds (B,), heights (B,) [m] and robots (B,)."""
    assert batch.labels is not None
    key = batch.labels.kind_and_height
    assert key is not None
    return (
        batch.labels.pick_pose,
        key[:, 0].long(),
        key[:, 1],
        batch.labels.decision[:, 0].clamp(min=0),
    )


MODELS.add("keypose", (KeyPoseModel, KeyPoseConfig))
