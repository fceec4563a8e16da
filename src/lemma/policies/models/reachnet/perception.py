"""ReachNet's perception: from a top-down map to poses of entities and robots.

A U-Net predicts the cell of each entity, of a point ahead on the stick and of each
robot's base, the offset in the cell, and the yaw of cubes. Each softmax over cells has
one more class for "not present".
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lemma.core.arguments import Depth, Share, Size, Width, Widths
from lemma.policies.batch import Batch
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.layers import (
    Network,
    ResidualBlock,
    constant,
    norm,
    upsample_to,
)
from lemma.policies.models.grid import Cells
from lemma.policies.models.reachnet.marks import STRIDE, Marks, read_points
from lemma.policies.models.reachnet.memory import Sighting
from lemma.policies.models.reachnet.scene_table import COLUMNS, HEADING_M, SceneTable
from lemma.scene.raster import RASTER

_IMAGE, _INPUTS = 5, 5 * STRIDE**2 + 2
_HEIGHT_M = 0.1
_REACH_RADII_M = ((0.05, 0.35), (0.4, 1.8), (0.0, 0.2))
"""Bounds of the radii of reach [m]: the inner one, the outer one, and the increase of
the outer one for low objects."""
_PROFILE = 3
_PROFILE_WIDTH, _PROFILE_KERNEL = 16, 7
_TABLE_M = 0.05
_NEAR = 1
_CELLS = math.log(RASTER.rows * RASTER.columns / STRIDE**2)
_MARKS = 3.0
_NEAR_HEIGHT_CELLS = 1
_HALF = math.log(0.5)


@dataclass(frozen=True)
class PerceptionConfig:
    """Options of perception."""

    widths: Widths = (64, 96, 160, 224)
    """Channels at 1/4, 1/8 ... of the map's resolution."""
    blocks: Depth = 2
    """Residual blocks at each resolution of the encoder."""
    ring_width: Width = 64
    """Hidden width of the network from features of a robot to its reach."""
    heading_m: Size = HEADING_M
    """Position of the point ahead on the stick's x axis [m], which with its origin
    gives its pose; 0.75 in weights of earlier releases."""
    joint_dropout: Share = 0.3
    """Share of robots without joint angles in training, so that reach is also estimated
    from the image."""


class _Trunk(nn.Module):
    """The U-Net, from an image to features of its cells and the coarsest features."""

    def __init__(self, config: PerceptionConfig) -> None:
        super().__init__()
        first = config.widths[0]
        self.stem = nn.Sequential(
            nn.Conv2d(_INPUTS, first, 3, padding=1, bias=False), norm(first), nn.SiLU()
        )
        self.down, wide = nn.ModuleList(), first
        for level, width in enumerate(config.widths):
            blocks = [ResidualBlock(wide, width, stride=1 if level == 0 else 2)]
            blocks += [ResidualBlock(width, width) for _ in range(config.blocks - 1)]
            self.down.append(nn.Sequential(*blocks))
            wide = width
        self.lift, self.up = nn.ModuleList(), nn.ModuleList()
        for width in reversed(config.widths[:-1]):
            self.lift.append(nn.Conv2d(wide, width, 1, bias=False))
            self.up.append(ResidualBlock(width, width))
            wide = width

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        x = self.stem(image)
        kept = []
        for down in self.down:
            x = down(x)
            kept.append(x)
        coarse = kept.pop()
        for lift, up in zip(self.lift, self.up, strict=True):
            skip = kept.pop()
            x = up(upsample_to(lift(x), skip) + skip)
        return x, coarse


class Perception(Network):
    """A network from maps to scene tables."""

    def __init__(
        self,
        config: PerceptionConfig,
        robots: int,
        entities: EntitySet = BENCHMARK,
    ) -> None:
        """Make the weights.

        Args:
            config: Options.
            robots: Number of robots of a team.
            entities: Entities, in the order of their numbers.
        """
        super().__init__()
        self.config, self.robots, self.entities = config, robots, entities
        self.folds = tuple(sorted(set(_folds(entities)) - {0})) or (1,)
        first = config.widths[0]
        self.trunk = _Trunk(config)
        marked = len(entities) + 1 + robots
        self.mark = nn.Conv2d(first, marked, 1)
        # Initially as likely as all cells of a usual map together.
        self.nowhere = nn.Parameter(torch.full((marked,), _CELLS))
        self.offset = nn.Conv2d(first, 2 * marked, 1)
        self.turn = nn.Conv2d(first, 2 * len(self.folds), 1)
        joints = 12
        self.ring = nn.Sequential(
            nn.Linear(config.widths[-1] + joints + 1, config.ring_width),
            nn.SiLU(),
            nn.Linear(config.ring_width, len(_REACH_RADII_M)),
        )
        self.ground = nn.Sequential(
            nn.Conv1d(_PROFILE, _PROFILE_WIDTH, _PROFILE_KERNEL, padding="same"),
            nn.SiLU(),
            nn.Conv1d(_PROFILE_WIDTH, 1, _PROFILE_KERNEL, padding="same"),
        )

    def forward(self, batch: Batch) -> tuple[Marks, Tensor]:
        """Return the marks, and the coarsest features, (B, channels, h, w).

        Args:
            batch: Maps whose sides are multiples of ``STRIDE``.
        """
        x, coarse = self.trunk(_image(batch))
        with torch.autocast(x.device.type, enabled=False):
            return self._marks(x.float()), coarse.float()

    def _marks(self, x: Tensor) -> Marks:
        count, _, rows, columns = x.shape
        logits = self.mark(x).flatten(2)
        nowhere = self.nowhere[:, None].expand(count, -1, 1)
        offsets = self.offset(x).view(count, -1, 2, rows * columns)
        return Marks(
            torch.cat([logits, nowhere], 2).log_softmax(2),
            offsets,
            self.turn(x).view(count, len(self.folds), 2, rows * columns),
            x.flatten(2),
            (rows, columns),
        )

    def reach(self, coarse: Tensor, batch: Batch, bases: Tensor) -> Tensor:
        """Return the radii of each robot's reach, (B, R, 3) [m].

        Args:
            coarse: The coarsest features, (B, channels, h, w).
            batch: Batch with the robots' joints.
            bases: World positions of the bases, (B, R, 2) [m].
        """
        raster = batch.raster
        half = constant((raster.columns, -raster.rows), bases.device) * (
            raster.cell_m / 2
        )
        grid = (bases / half).clamp(-1.0, 1.0).unsqueeze(2)
        seen = F.grid_sample(coarse, grid, align_corners=False).squeeze(3)
        joints = torch.cat([batch.joints.sin(), batch.joints.cos()], -1).float()
        kept = torch.ones_like(joints[..., :1])
        if self.training:
            kept = (torch.rand_like(kept) >= self.config.joint_dropout).float()
        parts = [seen.transpose(1, 2), joints * kept, kept]
        share = self.ring(torch.cat(parts, -1)).sigmoid()
        low, high = constant(_REACH_RADII_M, share.device).unbind(-1)
        inner, outer, more = (low + (high - low) * share).unbind(-1)
        return torch.stack([inner, outer, outer + more], -1)

    def table_seen(self, batch: Batch) -> Tensor:
        """Return logits of a table at positions along x, (B, COLUMNS)."""
        on_it = batch.coverage & (batch.height_m.abs() < _TABLE_M)
        known = [batch.coverage, on_it, batch.coverage & ~on_it]
        profile = torch.stack([cells.float().mean(1) for cells in known], 1)
        logits: Tensor = self.ground(F.adaptive_avg_pool1d(profile, COLUMNS))
        return logits.squeeze(1).float()

    def sighting(self, marks: Marks, coarse: Tensor, batch: Batch) -> Sighting:
        """Return the likeliest place of every entity, and how likely it is there.

        Args:
            marks: Marks of the maps.
            coarse: Coarse features of the maps.
            batch: The maps.
        """
        count, stick = len(self.entities), self.entities.stick
        points = read_points(marks, stick, self.config.heading_m, batch.raster)
        xy, bases = points[:, :count], points[:, count + 1 :]
        cos, sin = self._turns(marks, _cells(batch).holding(xy)).unbind(2)
        fold = constant(_folds(self.entities), xy.device)
        along = points[:, count] - xy[:, stick]
        yaw = torch.atan2(sin, cos) / fold.clamp(min=1)
        yaw = torch.where(fold > 0, yaw, 0.0)
        yaw = torch.cat([yaw[:, :-1], torch.atan2(along[:, 1:], along[:, :1])], 1)
        absent = marks.points[:, :count, -1]
        cargo = torch.arange(count, device=xy.device) < self.entities.cargo
        table = SceneTable(
            present=absent < _HALF,
            xy=xy,
            yaw=yaw,
            top=torch.where(cargo, _top(batch, xy), 0.0),
            bases=bases,
            radii=self.reach(coarse, batch, bases),
            ground=self.table_seen(batch).sigmoid(),
            half_x_m=batch.raster.size_m[0] / 2,
            entities=self.entities,
        )
        shares = 1.0 - absent.exp()
        return Sighting(table, shares, shares)

    def table(
        self,
        marks: Marks,
        coarse: Tensor,
        batch: Batch,
        named: Tensor | None = None,
    ) -> SceneTable:
        """Return the scene tables of what is seen; see :meth:`sighting`.

        Args:
            marks: Marks of the maps.
            coarse: Coarse features of the maps.
            batch: The maps.
            named: Entities that are there even if they are hard to see, (B, E) bool.
        """
        seen = self.sighting(marks, coarse, batch).table
        return seen.showing(seen.present if named is None else seen.present | named)

    def _turns(self, marks: Marks, cell: Tensor) -> Tensor:
        """Return cosine and sine of each entity's yaw up to symmetry, (B, E, 2).

        Args:
            marks: Predicted marks.
            cell: Number of the cell of each, (B, E).
        """
        folds = _folds(self.entities)
        which = tuple(self.folds.index(fold) if fold else 0 for fold in folds)
        chosen = marks.yaw[:, constant(which, cell.device)]
        index = cell[:, :, None, None].expand(-1, -1, 2, 1)
        return chosen.gather(3, index).squeeze(3)

    def losses(
        self, marks: Marks, table: SceneTable, batch: Batch
    ) -> dict[str, Tensor]:
        """Return the losses of marks by name.

        Args:
            marks: Predicted marks.
            table: True scene.
            batch: The maps.
        """
        stick = table.stick
        yaw = table.yaw[:, stick]
        along = torch.stack([yaw.cos(), yaw.sin()], -1)
        end = table.xy[:, stick] + self.config.heading_m * along
        xy = torch.cat([table.xy, end[:, None], table.bases], 1)
        there = torch.cat(
            [
                table.present,
                table.present[:, stick, None],
                torch.ones_like(table.bases[..., 0], dtype=torch.bool),
            ],
            1,
        )
        cells = _cells(batch)
        cell, place = cells.holding(xy), cells.continuous(xy)
        limit = constant((cells.columns, cells.rows), xy.device)
        there = there & ((place >= 0) & (place < limit)).all(-1)
        target = torch.where(there, cell, marks.points.shape[2] - 1)
        found = -marks.points.gather(2, target[..., None])
        fold = constant(_folds(self.entities), xy.device)
        turn = self._turns(marks, cell[:, : len(self.entities)])
        wanted = fold * table.yaw
        wanted = torch.stack([wanted.cos(), wanted.sin()], -1)
        off = (turn - wanted).square().sum(-1)
        seen = there[:, : len(self.entities)] & (fold > 0)
        return {
            "marks": _MARKS * found.mean(),
            "offsets": self._offset_loss(marks, xy, there, batch),
            "ground": F.binary_cross_entropy_with_logits(
                self.table_seen(batch), table.ground
            ),
            "yaw": (torch.where(seen, off, 0.0).sum() / seen.sum().clamp(min=1)),
        }

    def _offset_loss(
        self, marks: Marks, xy: Tensor, there: Tensor, batch: Batch
    ) -> Tensor:
        """Return the loss of offsets, in the right cell and the cells around it."""
        rows, columns = marks.shape
        place = _cells(batch).continuous(xy)
        corner = place.floor()
        steps = torch.arange(-_NEAR, _NEAR + 1, device=xy.device)
        around = torch.cartesian_prod(steps, steps)
        near = corner[:, :, None] + around
        column, row = near.unbind(-1)
        valid = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        valid = valid & there[..., None]
        index = (row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)).long()
        predicted = marks.offsets.gather(3, index[:, :, None].expand(-1, -1, 2, -1))
        wanted = (place[:, :, None] - near - 0.5).transpose(2, 3)
        miss = F.smooth_l1_loss(predicted, wanted, beta=0.1, reduction="none").sum(2)
        return torch.where(valid, miss, 0.0).sum() / valid.sum().clamp(min=1)


def _image(batch: Batch) -> Tensor:
    """Return the input of the first convolution, (B, _INPUTS, H, W)."""
    parts = [
        batch.rgb.permute(0, 3, 1, 2).float() / 255.0,
        (batch.height_m / _HEIGHT_M).clamp(-1.0, 3.0)[:, None],
        batch.coverage[:, None].float(),
    ]
    image = F.pixel_unshuffle(torch.cat(parts, 1), STRIDE)
    count, _, rows, columns = image.shape
    x = torch.linspace(-1, 1, columns, device=image.device).expand(count, 1, rows, -1)
    y = torch.linspace(1, -1, rows, device=image.device)[:, None]
    return torch.cat([image, x, y.expand(count, 1, -1, columns)], 1)


def _cells(batch: Batch) -> Cells:
    return Cells.of(batch.raster, STRIDE)


def _top(batch: Batch, xy: Tensor) -> Tensor:
    """Return the mean height of the map around positions, (B, N) [m]."""
    raster = batch.raster
    column = torch.floor(raster.columns / 2 + xy[..., 0] / raster.cell_m).long()
    row = torch.floor(raster.rows / 2 - xy[..., 1] / raster.cell_m).long()
    total = torch.zeros_like(xy[..., 0])
    known = torch.zeros_like(total)
    near = _NEAR_HEIGHT_CELLS
    frames = torch.arange(len(xy), device=xy.device)[:, None]
    for a in range(-near, near + 1):
        for b in range(-near, near + 1):
            r = (row + a).clamp(0, raster.rows - 1)
            c = (column + b).clamp(0, raster.columns - 1)
            seen = batch.coverage[frames, r, c].float()
            total = total + seen * batch.height_m[frames, r, c]
            known = known + seen
    return total / known.clamp(min=1.0)


def _folds(entities: EntitySet) -> tuple[int, ...]:
    """Return the order of rotational symmetry of movable entities; 0 for full."""
    return tuple(
        round(math.tau / kind.grasp.turn_rad)
        if kind.cargo and kind.grasp and kind.grasp.turn_rad
        else 0
        for kind in entities.kinds
    )
