"""The Episodic Transformer: one token per word, per frame and per decision.

After Pashevich et al., Episodic Transformer for Vision-and-Language Navigation (2021),
with the heads of LEMMA. A frame is one token, pooled from a grid of 7 x 7 cells, unlike
in object-centric planners.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Count, Depth, Ratio, Share, Width, Widths
from lemma.env.view import View
from lemma.policies.batch import (
    MAX_PAST,
    NOBODY,
    PRIMITIVES,
    STOP,
    Batch,
    decision_numbers,
)
from lemma.policies.entities import BENCHMARK, EntitySet, traits_of
from lemma.policies.interfaces import PolicyInput
from lemma.policies.layers import (
    Network,
    ResidualBlock,
    TransformerLayer,
    drawn,
    norm,
    sinusoids,
)
from lemma.policies.models.base import MODELS, MapModel, subtask_of
from lemma.policies.models.cell_detector import CellDetector
from lemma.policies.models.view_cache import ViewCache
from lemma.policies.text.encoder import TextConfig, TextEncoder, TextKind
from lemma.tasks.subtask import SubTask

PARTS = ("robot", "primitive", "pick", "place")
"""Parts of a decision, in the order of its numbers."""
SLOTS = MAX_PAST + 1
"""Number of frames of the longest history, including the present one."""
_MOVE = PRIMITIVES.index("move")
_IMAGE_CHANNELS = 5
_HEIGHT_SCALE = 5.0
"""Scales heights of up to 20 cm to the range of colors."""


@dataclass(frozen=True)
class EpisodicTransformerConfig:
    """Options of the :class:`EpisodicTransformer`."""

    robots: Depth = 2
    """Number of robots of a team."""
    entities: tuple[str, ...] = ()
    """Names of its entities; all registered ones if empty."""
    text: TextKind = "words"
    """Kind of the text encoder: see ``TextConfig``."""
    width: Width = 384
    """Width of a token."""
    heads: Depth = 6
    """Number of heads of each attention."""
    text_layers: Depth = 2
    """Transformer layers over the words alone."""
    layers: Depth = 2
    """Transformer layers over words, frames and decisions."""
    channels: Widths = (48, 96, 192, 384)
    """Channels of the stages of the image network, each with half the resolution."""
    blocks: Depth = 2
    """Residual blocks in each stage; 2 make a ResNet-18."""
    grid: Depth = 7
    """Number of rows and of columns of the pooled grid."""
    cell_channels: Width = 64
    """Channels of each pooled cell."""
    max_words: Count = 40
    """Largest number of words; later words are not read."""
    dropout: Share = 0.1
    """Probability of dropout in training."""
    visual_dropout: Share = 0.3
    """Probability of dropout of the cells in training."""
    first_view_only: Share = 0.25
    """Share of training episodes in which all frames show the first view, as in
    multi-step planning."""
    second_look: bool = False
    """Whether a frame's token, once it has met the words, attends to the frame's cells.
    The paper's model does not: it has the single token alone."""
    detection: Ratio = 1.0
    """Weight of the loss of finding all entities in the cells. If 0, decisions alone
    train the image network; that of the original could detect objects before."""


class FrameNetwork(Network):
    """A ResNet from a map to the features of a grid of cells."""

    def __init__(self, config: EpisodicTransformerConfig) -> None:
        """Make the weights."""
        super().__init__()
        first = config.channels[0]
        self.stem = nn.Conv2d(_IMAGE_CHANNELS, first, 7, 2, 3, bias=False)
        self.stem_norm = norm(first)
        stages: list[nn.Module] = []
        before = first
        for i, channels in enumerate(config.channels):
            for block in range(config.blocks):
                stride = 2 if i and not block else 1
                stages.append(ResidualBlock(before, channels, stride))
                before = channels
        self.stages = nn.Sequential(*stages)
        self.pool = nn.AdaptiveAvgPool2d(config.grid)
        middle = max(before // 2, config.cell_channels)
        self.compress = nn.Sequential(
            nn.Conv2d(before, middle, 1),
            nn.SiLU(),
            nn.Conv2d(middle, config.cell_channels, 1),
            nn.SiLU(),
        )

    def forward(self, rgb: Tensor, height_m: Tensor, coverage: Tensor) -> Tensor:
        """Return the cells of each frame, (B, cell_channels * grid**2).

        Args:
            rgb: (B, rows, columns, 3) uint8.
            height_m: (B, rows, columns) [m].
            coverage: (B, rows, columns) bool.
        """
        color = rgb.permute(0, 3, 1, 2).float() / 255.0 - 0.5
        height = height_m.unsqueeze(1) * _HEIGHT_SCALE
        image = torch.cat([color, height, coverage.unsqueeze(1).float()], 1)
        x = self.stem(image.contiguous(memory_format=torch.channels_last))
        x = F.max_pool2d(F.silu(self.stem_norm(x)), 3, 2, 1)
        out: Tensor = self.compress(self.pool(self.stages(x))).flatten(1)
        return out


@dataclass(frozen=True, eq=False)
class TokenLayout:
    """Assignment of B frames to G episodes or parts of episodes."""

    episode: Tensor
    """Index of each frame's episode, (B,) int64."""
    slot: Tensor
    """Number of decisions before each frame in its episode, (B,) int64."""
    actions: Tensor
    """Decisions of each episode, (G, MAX_PAST, 4) int64, padded with -1."""
    instructions: list[str]
    """One instruction per episode."""
    foreseeable: Tensor
    """Whether the first frame determines the rest, because the execution was not
    perturbed, (G,) bool."""

    @property
    def present(self) -> Tensor:
        """Whether each slot has a frame, (G, SLOTS) bool."""
        found = self.episode.new_zeros(len(self.actions), SLOTS, dtype=torch.bool)
        found[self.episode, self.slot] = True
        return found


def layout_of_batch(batch: Batch) -> TokenLayout:
    """Return how a labelled batch splits into episodes.

    Consecutive frames of one episode are in one group, and each attends to the frames
    before it. A frame whose predecessor is not before it in the batch starts a new
    group; its history has the earlier decisions, but not the earlier frames.

    Args:
        batch: Batch with labels, with frames in any order.
    """
    assert batch.labels is not None
    done = (batch.past[:, :, 1] != NOBODY).sum(1)
    numbers = torch.stack([batch.labels.episode, batch.labels.keyframe, done])
    new = torch.ones_like(done, dtype=torch.bool)
    step = torch.tensor([[0], [1], [1]], device=done.device)
    new[1:] = (numbers[:, 1:] - numbers[:, :-1] != step).any(0)
    # The last frame of a group is before the first one of the next.
    last = torch.cat([new[1:], new[:1]])
    firsts = torch.nonzero(new).flatten().tolist()
    return TokenLayout(
        episode=new.cumsum(0) - 1,
        slot=done,
        actions=batch.past[last],
        instructions=[batch.instructions[first] for first in firsts],
        foreseeable=~batch.labels.perturbed[new],
    )


def layout_of_inputs(
    inputs: Sequence[PolicyInput],
    device: torch.device,
    entities: EntitySet = BENCHMARK,
) -> tuple[TokenLayout, list[View], Tensor]:
    """Return the layout and the views of policies' inputs.

    Args:
        inputs: One per episode.
        device: Device of the tensors.
        entities: Entities, in the order of their numbers.

    Returns:
        The layout; the different views; and for each frame of the layout the index of
        its view, (B,).
    """
    views: dict[View, int] = {}
    episodes, slots, shown = [], [], []
    actions = torch.full((len(inputs), MAX_PAST, 4), NOBODY)
    for number, policy_input in enumerate(inputs):
        steps = policy_input.past[-MAX_PAST:]
        for slot, step in enumerate(steps):
            numbers = decision_numbers(step.subtask.to_dict(), entities)
            actions[number, slot] = torch.tensor(numbers)
        seen = [*(step.view for step in steps), policy_input.view]
        for slot, view in enumerate(seen):
            episodes.append(number)
            slots.append(slot)
            shown.append(views.setdefault(view, len(views)))
    layout = TokenLayout(
        episode=torch.tensor(episodes, device=device),
        slot=torch.tensor(slots, device=device),
        actions=actions.to(device),
        instructions=[policy_input.instruction for policy_input in inputs],
        foreseeable=torch.ones(len(inputs), dtype=torch.bool, device=device),
    )
    return layout, list(views), torch.tensor(shown, device=device)


class EpisodicTransformer(MapModel):
    """A planner whose input is all frames and decisions of the episode."""

    unit: ClassVar[Literal["frame", "episode"]] = "episode"
    selection: ClassVar[str] = "plan"
    former_names: ClassVar[Mapping[str, str]] = {r"^text\.reader\.": "text."}
    former_options: ClassVar[Mapping[str, Any]] = {"detection": 0.0}
    config: EpisodicTransformerConfig

    def __init__(self, config: EpisodicTransformerConfig) -> None:
        """Make the weights."""
        super().__init__()
        named = EntitySet.of(config.entities)
        self.config = config = replace(config, entities=named.names)
        width = config.width
        self.text = TextEncoder(
            TextConfig(
                kind=config.text,
                width=width,
                layers=config.text_layers,
                heads=config.heads,
                max_words=config.max_words,
                dropout=config.dropout,
            )
        )
        cells = config.cell_channels * config.grid**2
        self.frames = FrameNetwork(config)
        self.frame_dropout = nn.Dropout(config.visual_dropout)
        self.frame_token = nn.Linear(cells, width)
        self.frame_skip = nn.Linear(cells, width)
        sizes = (config.robots, len(PRIMITIVES), len(named), len(named.places))
        # Number 0 stands for no robot and no entity.
        self.decisions = nn.ModuleList(nn.Embedding(n + 1, width) for n in sizes)
        self.kinds = drawn(3, width)
        self.times: Tensor
        self.register_buffer("times", sinusoids(SLOTS, width), persistent=False)
        self.norm_in = nn.LayerNorm(width)
        self.layers = nn.ModuleList(
            # Unlike in most transformers, the hidden width equals the token width.
            TransformerLayer(width, config.heads, width, config.dropout)
            for _ in range(config.layers)
        )
        self.norm_out = nn.LayerNorm(width)
        if config.second_look:
            self.cell_token = nn.Linear(config.cell_channels, width)
            self.cell_places = drawn(config.grid**2, width)
            # Its attention from token to token has one token only: it is a projection.
            self.look = nn.TransformerDecoderLayer(
                width,
                config.heads,
                width,
                config.dropout,
                batch_first=True,
                norm_first=True,
            )
        if config.detection:
            self.detector = CellDetector(config.cell_channels, len(named))
        self.heads = nn.ModuleList(nn.Linear(width, n) for n in sizes)
        self._seen: ViewCache[Tensor] = ViewCache()

    def forward(self, batch: Batch) -> list[Tensor]:
        """Return the scores of every choice, for each part of a decision, (B, n).

        Args:
            batch: Batch with labels, which have the episodes of frames; see
                :func:`layout_of_batch`.
        """
        return self._decide(self._cells(batch), layout_of_batch(batch))

    def _cells(self, batch: Batch) -> Tensor:
        cells: Tensor = self.frames(batch.rgb, batch.height_m, batch.coverage)
        return cells

    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Return the cross-entropy of each part of the decision, and of detection."""
        assert batch.labels is not None
        targets, cells = batch.labels.decision, self._cells(batch)
        scores = self._decide(cells, layout_of_batch(batch))
        terms = {
            part: _cross_entropy(scores[i].float(), targets[:, i])
            for i, part in enumerate(PARTS)
        }
        weight = self.config.detection
        if weight:
            objects = batch.labels.objects
            found = self.detector.loss(self._each(cells), objects, batch.raster)
            terms["detection"] = weight * found
        return terms

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return whether each part is right, and whether all are (``plan``), (B,)."""
        assert batch.labels is not None
        targets = batch.labels.decision
        right = choose(self.forward(batch), batch.entities) == targets
        absent = (targets == NOBODY).to(torch.bool)
        parts = {
            part: right[:, i].float().masked_fill(absent[:, i], torch.nan)
            for i, part in enumerate(PARTS)
        }
        return {**parts, "plan": right.all(1).float()}

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode; see ``Planner``."""
        with self.deciding():
            numbers = choose(self._scores_of(inputs), self.entities).tolist()
        return [subtask_of(row, self.entities) for row in numbers]

    def _scores_of(self, inputs: Sequence[PolicyInput]) -> list[Tensor]:
        device = self.device
        layout, views, shown = layout_of_inputs(inputs, device, self.entities)
        scores = self._decide(self._cells_of(views)[shown], layout)
        # The present frame is the last one of each episode.
        present = torch.cumsum(torch.bincount(layout.episode), 0) - 1
        scores = [part[present] for part in scores]
        robots = torch.tensor(
            [len(policy_input.robots) for policy_input in inputs], device=device
        )
        absent = torch.arange(self.config.robots, device=device) >= robots[:, None]
        return [scores[0].masked_fill(absent, -torch.inf), *scores[1:]]

    def _cells_of(self, views: list[View]) -> Tensor:
        """Return the cells of views; compute only those that are not cached."""
        seen = self._seen.valid(self.frames)
        new = [view for view in views if view not in seen]
        if new:
            maps = [
                torch.from_numpy(np.stack([getattr(view, name) for view in new]))
                for name in ("rgb", "height_m", "coverage")
            ]
            cells = self.frames(*(one.to(self.device) for one in maps))
            seen.update(zip(new, cells, strict=True))
        return torch.stack([seen[view] for view in views])

    def _decide(self, cells: Tensor, layout: TokenLayout) -> list[Tensor]:
        if self.training and self.config.first_view_only:
            cells = self._first_views(cells, layout)
        cells = self.frame_dropout(cells)
        where = (layout.episode, layout.slot)
        words, mask = self.text.encode(layout.instructions)
        token = self.frame_token(cells)
        frames = token.new_zeros(len(words), SLOTS, token.shape[1])
        frames = frames.index_put(where, token)
        present = layout.present
        tokens = torch.cat(
            [
                words + self.kinds[0],
                frames + self.kinds[1] + self.times,
                self._decision_tokens(layout) + self.kinds[2] + self.times[:-1],
            ],
            dim=1,
        )
        attends = attention_mask(mask, present, layout.actions[:, :, 1] != NOBODY)
        tokens = self.norm_in(tokens)
        for layer in self.layers:
            tokens = layer(tokens, attends)
        at_frames = tokens[:, mask.shape[1] : mask.shape[1] + SLOTS][where]
        if self.config.second_look:
            at_frames = self._look_again(at_frames, cells)
        out = self.norm_out(at_frames)
        objects = out + self.frame_skip(cells)
        inputs = (out, out, objects, objects)
        return [head(x) for head, x in zip(self.heads, inputs, strict=True)]

    def _each(self, cells: Tensor) -> Tensor:
        """Return the features of each cell, (B, grid**2, cell_channels)."""
        return cells.reshape(len(cells), self.config.cell_channels, -1).mT

    def _look_again(self, at_frames: Tensor, cells: Tensor) -> Tensor:
        """Return the token of each frame after a look at its cells, (B, width)."""
        keys = self.cell_token(self._each(cells)) + self.cell_places
        looked: Tensor = self.look(at_frames.unsqueeze(1), keys)
        return looked.squeeze(1)

    def _first_views(self, cells: Tensor, layout: TokenLayout) -> Tensor:
        counts = torch.bincount(layout.episode, minlength=len(layout.actions))
        firsts = torch.cumsum(counts, 0) - counts
        chosen = torch.rand(len(firsts), device=cells.device)
        frozen = (chosen < self.config.first_view_only) & (layout.slot[firsts] == 0)
        # After a perturbation the first frame does not determine the decisions.
        frozen &= layout.foreseeable
        shown = cells[firsts[layout.episode]]
        return torch.where(frozen[layout.episode].unsqueeze(1), shown, cells)

    def _decision_tokens(self, layout: TokenLayout) -> Tensor:
        numbers = (layout.actions + 1).unbind(2)
        parts = [table(n) for table, n in zip(self.decisions, numbers, strict=True)]
        return torch.stack(parts).sum(0)


def attention_mask(words: Tensor, frames: Tensor, decisions: Tensor) -> Tensor:
    """Return the attention mask over words, frames and decisions, (G, N, N) bool.

    Words attend to words. A frame attends to all words, to itself and earlier frames,
    and to earlier decisions. A decision attends to the same tokens as its frame, and to
    itself. Padding attends to itself, so that no row is empty.

    Args:
        words: True for words, False for padding, (G, words).
        frames: The same for frames, (G, slots).
        decisions: The same for decisions, (G, slots - 1).
    """
    groups, count = words.shape
    slots = frames.shape[1]
    there = torch.cat([words, frames, decisions], 1)
    time = torch.arange(slots, device=words.device)
    when = torch.cat([time.new_full((count,), -1), time, time[:-1] + 0.5])
    kind_words = when < 0
    # Decision t is between frames t and t + 1.
    earlier = when[None, :] <= when[:, None]
    allowed = torch.where(kind_words[:, None], kind_words[None, :], earlier)
    myself = torch.eye(len(when), dtype=torch.bool, device=words.device)
    return (allowed & there[:, None, :]) | myself.expand(groups, -1, -1)


def choose(scores: Sequence[Tensor], entities: EntitySet = BENCHMARK) -> Tensor:
    """Return the best valid decisions, (B, 4); -1 except the primitive for ``stop``.

    Valid is ``move`` with a cube or the stick to another place, and any other primitive
    with the stick on a cube. Whether the objects are present is left to the network.

    Args:
        scores: Scores of robots, primitives, picked and place entities, (B, n) each.
        entities: Entities, in the order of their numbers.
    """
    robot, primitive, pick, place = (part.float() for part in scores)
    kind = primitive.argmax(1)
    pairs = pick.unsqueeze(2) + place.unsqueeze(1)
    sensible = _sensible(entities).to(pairs.device)[kind]
    objects = pairs.masked_fill(~sensible, -torch.inf).flatten(1).argmax(1)
    count = len(entities.places)
    chosen = torch.stack([robot.argmax(1), kind, objects // count, objects % count], 1)
    nothing = torch.full_like(chosen, NOBODY)
    nothing[:, 1] = STOP
    return torch.where((kind == STOP)[:, None], nothing, chosen)


@cache
def _sensible(entities: EntitySet) -> Tensor:
    """Return the mask of valid decisions, (primitives, picks, places) bool."""
    traits, stick = traits_of(entities, torch.device("cpu")), entities.stick
    shape = len(PRIMITIVES), len(entities), len(entities.places)
    found = torch.zeros(shape, dtype=torch.bool)
    found[:, stick, : len(entities)] = traits.draggable
    moves = traits.graspable[:, None].repeat(1, len(entities.places))
    moves[:, stick] = False
    found[_MOVE] = moves.fill_diagonal_(False)
    return found


def _cross_entropy(scores: Tensor, targets: Tensor) -> Tensor:
    total = F.cross_entropy(scores, targets, ignore_index=NOBODY, reduction="sum")
    return total / (targets != NOBODY).sum().clamp(min=1)


MODELS.add("episodic-transformer", (EpisodicTransformer, EpisodicTransformerConfig))
