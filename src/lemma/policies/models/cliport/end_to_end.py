"""M-CLIPort: CLIPort end to end, from an instruction to robot, primitive, poses.

The networks are CLIPort's. The pick head says for each cell also which robot and which
primitive would pick there (paper, section V); they are read where it picks. ``stop``
picks nowhere, so it is read from the picture as a whole. It remembers nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share
from lemma.core.robot_names import robot_name
from lemma.policies.batch import PRIMITIVES, STOP, Batch, batch_of
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.policies.models.base import MODELS
from lemma.policies.models.cliport.grid import read_at
from lemma.policies.models.cliport.heads import Attention, pick_cells
from lemma.policies.models.cliport.model import (
    AT_ONCE,
    CLIPortConfig,
    PickAndPlace,
    grounded,
)
from lemma.policies.models.cliport.poses import (
    Poses,
    counted,
    mean_over,
    pick_losses,
    picks,
    place_losses,
    places,
    score_poses,
)
from lemma.tasks.subtask import STOP as STOP_SUBTASK
from lemma.tasks.subtask import Primitive, SubTask

_PRIMITIVES = tuple(name for name in PRIMITIVES if name != PRIMITIVES[STOP])
_STOP_WIDTH = 128


@dataclass(frozen=True)
class MCLIPortConfig(CLIPortConfig):
    """Options of :class:`MCLIPort`."""

    word_dropout: Share = 0.1
    """Share of words that are unknown in training."""
    robots: Depth = 2
    """Number of robots of every scene."""


@dataclass(frozen=True)
class _Answer:
    """Decisions: (B,) each, and poses."""

    stop: Tensor
    robot: Tensor
    primitive: Tensor
    poses: Poses


class MCLIPort(PickAndPlace):
    """Decides who does what, and where, from the instruction of the task."""

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
        counts, pick, place = counted(batch.labels)
        image, to_pick, to_place = self.look(batch)
        seen = self.pick(image, to_pick)
        cells = pick_cells(batch.raster)
        near = cells.around(cells.holding(pick[:, :2]))
        who, what = self._symbols(seen, near)
        robot, primitive = batch.labels.decision[:, :2].unbind(1)
        stops = self.stop(seen.context).float()[:, 0]
        return {
            **pick_losses(self.pick, seen, pick, counts, batch.raster),
            **place_losses(
                (self.place, self.zoom),
                (image, to_place),
                Poses(pick, place),
                counts,
                batch.raster,
            ),
            "robot": mean_over(_mean_entropy(who, robot.clamp(min=0)), counts),
            "primitive": mean_over(
                _mean_entropy(what, primitive.clamp(max=STOP - 1)), counts
            ),
            "stop": F.binary_cross_entropy_with_logits(stops, (~counts).float()),
        }

    def score(self, batch: Batch) -> dict[str, Tensor]:
        """Return whether decisions are the expert's, and how near the poses come."""
        assert batch.labels is not None
        with self.deciding():
            found = self._decide(batch)
            scores = score_poses(found.poses, batch.labels, batch.entities)
            robot, primitive = batch.labels.decision[:, :2].unbind(1)
            stops = primitive == STOP
            right_robot = (found.robot == robot).float()
            right_primitive = (found.primitive == primitive).float()
            acts = right_robot * right_primitive * scores["grounded"].nan_to_num()
            decided = torch.where(stops, found.stop.float(), acts * ~found.stop)
            return {
                "decided": decided,
                "right_stop": (found.stop == stops).float(),
                "right_robot": right_robot.masked_fill(stops, torch.nan),
                "right_primitive": right_primitive.masked_fill(stops, torch.nan),
                **scores,
            }

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode; it names no entities."""
        found = []
        for start in range(0, len(inputs), AT_ONCE):
            part = inputs[start : start + AT_ONCE]
            raster = self.config.raster(part[0])
            with self.deciding():
                answer = self._decide(
                    batch_of(part, raster, (), self.device, self.entities)
                )
            found += _decisions(answer)
        return found

    def _decide(self, batch: Batch) -> _Answer:
        image, to_pick, to_place = self.look(batch)
        seen = self.pick(image, to_pick)
        pick, numbers = picks(self.pick, seen, batch.raster)
        place = places(self.place, self.zoom, (image, to_place), pick, batch.raster)
        who, what = self._symbols(seen, numbers[:, None])
        return _Answer(
            stop=self.stop(seen.context)[:, 0] > 0.0,
            robot=who[:, 0].argmax(-1),
            primitive=what[:, 0].argmax(-1),
            poses=Poses(pick, place),
        )

    def _symbols(self, seen: Attention, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits of robots and primitives in pick cells, (B, K, ...)."""
        read = read_at(seen.maps[:, 1:], numbers).float()
        return read[..., : self.robots], read[..., self.robots :]


def _mean_entropy(logits: Tensor, wanted: Tensor) -> Tensor:
    """Return the cross-entropy of each frame, (B,), over cells (B, K, classes)."""
    each = wanted[:, None].expand(-1, logits.shape[1])
    return F.cross_entropy(logits.transpose(1, 2), each, reduction="none").mean(1)


def _decisions(answer: _Answer) -> list[Decision]:
    decisions = []
    rows = zip(
        answer.stop.tolist(),
        answer.robot.tolist(),
        answer.primitive.tolist(),
        answer.poses.pick.tolist(),
        answer.poses.place.tolist(),
        strict=True,
    )
    for stops, robot, primitive, pick, place in rows:
        if stops:
            decisions.append(Decision(STOP_SUBTASK, None))
            continue
        subtask = SubTask(robot_name(robot), Primitive(_PRIMITIVES[primitive]))
        decisions.append(Decision(subtask, grounded(subtask, pick, place)))
    return decisions


MODELS.add("m-cliport", (MCLIPort, MCLIPortConfig))
