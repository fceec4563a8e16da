"""Exchange the colors of cubes and pads: in images, labels and goals alike.

Only cells where an object truly lies, at its height and in its color, are painted, so
that an arm, the stick or a cube on top of it keeps its own.
"""

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch, Labels
from lemma.scene.objects.cube import CUBE
from lemma.scene.objects.entity import ENTITIES
from lemma.scene.objects.pad import PAD_RADIUS_M, PAD_THICKNESS_M
from lemma.scene.palette import BENCHMARK_COLORS, OBJECT_COLORS, STICK, TABLE
from lemma.tasks.language.template import GoalPairs

COLORS = BENCHMARK_COLORS
_COUNT = len(COLORS)
_HEIGHT_TOLERANCE_M = 0.010
"""More than the noise of a measured height, less than the stick above a pad."""
_REFERENCES = (*(OBJECT_COLORS[name] for name in COLORS), STICK, TABLE)
_WHITE = COLORS.index("white")
_TABLE = len(_REFERENCES) - 1
_LEAST_WHITE = 0.72
"""Of white; the table is half as bright."""
_LEAST_LIGHT = 0.12
"""Darker cells have no color."""


def permute_colors(batch: Batch, permutation: Tensor) -> Batch:
    """Return a batch in which colors are others; sentences are left as they are.

    Args:
        batch: With labels.
        permutation: Number of the new color by that of the old one, (B, 5) int64.
    """
    labels = batch.labels
    assert labels is not None
    tables = _entity_tables(permutation)
    goals = [
        _said_anew(goal, tuple(new))
        for goal, new in zip(labels.goals, permutation.tolist(), strict=True)
    ]
    return replace(
        batch,
        rgb=_painted(batch, labels, permutation),
        past=_renamed(batch.past, tables),
        labels=replace(
            labels,
            decision=_renamed(labels.decision, tables),
            objects=_reordered(labels.objects, tables),
            goals=goals,
        ),
    )


def _entity_tables(permutation: Tensor) -> Tensor:
    """Return the new number of each entity, of ``shared`` and of nobody, (B, 13)."""
    rest = torch.tensor(
        [*range(2 * _COUNT, len(ENTITIES) + 1), NOBODY], device=permutation.device
    ).expand(len(permutation), -1)
    return torch.cat([permutation, permutation + _COUNT, rest], 1)


def _renamed(decisions: Tensor, tables: Tensor) -> Tensor:
    """Return decisions (B, ..., 4) that speak of other colors."""
    named = decisions[..., 2:].reshape(len(decisions), -1)
    # Nobody, -1, is the last row of a table.
    new = tables.gather(1, named % tables.shape[1]).view(decisions[..., 2:].shape)
    return torch.cat([decisions[..., :2], new], -1)


def _reordered(objects: Tensor, tables: Tensor) -> Tensor:
    """Return true poses (B, 11, 7) in the rows of the new colors."""
    rows = tables[:, : len(ENTITIES), None].expand_as(objects)
    return torch.empty_like(objects).scatter_(1, rows, objects)


@lru_cache(maxsize=65536)
def _said_anew(goal: GoalPairs, new: tuple[int, ...]) -> GoalPairs:
    def renamed(entity: str) -> str:
        number = ENTITIES.index(entity)
        if number >= 2 * _COUNT:
            return entity
        kind, color = divmod(number, _COUNT)
        return ENTITIES[kind * _COUNT + new[color]]

    return tuple((renamed(top), renamed(bottom)) for top, bottom in goal)


def _painted(batch: Batch, labels: Labels, permutation: Tensor) -> Tensor:
    """Return the maps (B, rows, columns, 3) with objects in other colors."""
    objects = labels.objects[:, : 2 * _COUNT]
    rows, columns = _windows(batch, objects)
    frames = torch.arange(len(batch), device=rows.device).view(-1, 1, 1)
    cells = (frames, rows, columns)
    old, height_m = batch.rgb[cells].float() / 255.0, batch.height_m[cells]
    palette = old.new_tensor([OBJECT_COLORS[name][:3] for name in COLORS])
    source = palette.repeat(2, 1)[None, :, None]
    target = palette[permutation].repeat(1, 2, 1)[:, :, None]
    # How bright a cell is beside its palette color says how it is lit.
    light = (old * source).sum(-1, keepdim=True) / (source * source).sum(-1, True)
    above_m = height_m - objects[..., 2:3]
    inside = _footprints(batch, objects, rows, columns) & batch.coverage[cells]
    inside &= _at_top(above_m)
    inside &= _shows_own_color(old, light[..., 0], above_m)
    new = (light * target * 255.0).round().clamp(0, 255).to(torch.uint8)
    # What is not painted is written to a cell behind the last one.
    height, width = batch.coverage.shape[1:]
    flat = (frames * height + rows) * width + columns
    count = len(batch) * height * width
    flat = torch.where(inside, flat, count)
    image = torch.cat([batch.rgb.reshape(-1, 3), batch.rgb.new_zeros(1, 3)])
    image[flat.reshape(-1)] = new.reshape(-1, 3)
    return image[:-1].view(batch.rgb.shape)


def _windows(batch: Batch, objects: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows and columns of cells around objects, (B, entities, window)."""
    raster = batch.raster
    reach = int((PAD_RADIUS_M + raster.cell_m) / raster.cell_m) + 1
    xy = objects[..., :2].nan_to_num(0.0)
    row = torch.floor(raster.rows / 2 - xy[..., 1] / raster.cell_m).long()
    column = torch.floor(raster.columns / 2 + xy[..., 0] / raster.cell_m).long()
    steps = torch.arange(-reach, reach + 1, device=objects.device)
    down, right = torch.meshgrid(steps, steps, indexing="ij")
    rows = row[..., None] + down.reshape(-1)
    columns = column[..., None] + right.reshape(-1)
    # Cells outside are replaced by ones at the border, which lie nowhere near.
    return rows.clamp(0, raster.rows - 1), columns.clamp(0, raster.columns - 1)


def _footprints(batch: Batch, objects: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Return which cells of the windows touch their object, (B, entities, window)."""
    raster = batch.raster
    margin = 0.75 * raster.cell_m
    x = (columns + 0.5 - raster.columns / 2) * raster.cell_m - objects[..., 0:1]
    y = (raster.rows / 2 - rows - 0.5) * raster.cell_m - objects[..., 1:2]
    w, _, _, z = objects[..., 3:].unbind(-1)
    yaw = 2.0 * torch.atan2(z, w)[..., None]
    along = (torch.cos(yaw) * x + torch.sin(yaw) * y).abs()
    across = (torch.cos(yaw) * y - torch.sin(yaw) * x).abs()
    cube = torch.maximum(along, across) < CUBE.origin_m + margin
    pad = torch.hypot(x, y) < PAD_RADIUS_M + margin
    # Where an entity is missing its pose is NaN, so that nothing is inside.
    return torch.cat([cube[:, :_COUNT], pad[:, _COUNT:]], 1)


def _at_top(above_m: Tensor) -> Tensor:
    """Return which cells are not above their object, (B, entities, window)."""
    top = above_m.new_tensor([CUBE.origin_m] * _COUNT + [PAD_THICKNESS_M] * _COUNT)
    return above_m < top[:, None] + _HEIGHT_TOLERANCE_M


def _shows_own_color(rgb: Tensor, light: Tensor, above_m: Tensor) -> Tensor:
    """Return which cells have their object's color, however they are lit.

    Args:
        rgb: Colors of 0 to 1, (B, entities, window, 3).
        light: How bright cells are beside their object's palette color.
        above_m: Height of cells above the middle of their object.
    """
    references = rgb.new_tensor([color[:3] for color in _REFERENCES])
    directions = torch.nn.functional.normalize(references, dim=-1)
    nearest = (rgb @ directions.T).argmax(-1)
    own = torch.arange(_COUNT, device=rgb.device).repeat(2)[:, None]
    # The table is grey and a white object in the dark is too; only a cube is high.
    grey = (nearest == _WHITE) | (nearest == _TABLE)
    white = grey & ((light > _LEAST_WHITE) | (above_m > -CUBE.origin_m / 2))
    white[:, _COUNT:] &= light[:, _COUNT:] > _LEAST_WHITE
    return torch.where(own == _WHITE, white, nearest == own) & (light > _LEAST_LIGHT)
