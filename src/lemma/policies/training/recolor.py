"""Exchange the colors of objects: in images, labels and goals alike.

Only cells where an object truly lies, at its height and in its color, are painted, so
that an arm, the stick or a cube on top of it keeps its own.
"""

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch, Labels
from lemma.policies.entities import EntitySet, traits_of
from lemma.scene.objects.kind import Part
from lemma.scene.objects.palette import OBJECT_COLORS, STICK, TABLE
from lemma.tasks.language.template import GoalPairs

_HEIGHT_TOLERANCE_M = 0.010
"""More than the noise of a measured height, less than a thing above another."""
_WHITE = "white"
_LEAST_WHITE = 0.72
"""Least brightness of white, as a share; the table is half as bright."""
_LEAST_LIGHT = 0.12
"""Darker cells have no color."""


def permute_colors(batch: Batch, permutation: Tensor) -> Batch:
    """Return a batch in which colors are others; sentences are left as they are.

    Args:
        batch: With labels.
        permutation: Number, in ``batch.entities.colors``, of the new color by that of
            the old one, (B, colors) int64.
    """
    labels, entities = batch.labels, batch.entities
    assert labels is not None
    tables = _entity_tables(permutation, entities)
    goals = [
        _said_anew(goal, entities, tuple(new))
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


def _entity_tables(permutation: Tensor, entities: EntitySet) -> Tensor:
    """Return the new number of each entity, of ``shared`` and of nobody, (B, E + 2)."""
    device = permutation.device
    alike = torch.tensor(entities.colored_as, device=device)
    color = permutation[:, list(entities.color_numbers)]
    numbers = alike.expand(len(color), -1, -1).gather(2, color[..., None]).squeeze(2)
    rest = torch.tensor([entities.shared, NOBODY], device=device)
    return torch.cat([numbers, rest.expand(len(permutation), -1)], 1)


def _renamed(decisions: Tensor, tables: Tensor) -> Tensor:
    """Return decisions (B, ..., 4) that speak of other colors."""
    named = decisions[..., 2:].reshape(len(decisions), -1)
    # Nobody, -1, is the last row of a table.
    new = tables.gather(1, named % tables.shape[1]).view(decisions[..., 2:].shape)
    return torch.cat([decisions[..., :2], new], -1)


def _reordered(objects: Tensor, tables: Tensor) -> Tensor:
    """Return true poses (B, E, 7) in the rows of the new colors."""
    rows = tables[:, : objects.shape[1], None].expand_as(objects)
    return torch.empty_like(objects).scatter_(1, rows, objects)


@lru_cache(maxsize=65536)
def _said_anew(goal: GoalPairs, entities: EntitySet, new: tuple[int, ...]) -> GoalPairs:
    def renamed(entity: str) -> str:
        number = entities.number(entity)
        color = new[entities.color_numbers[number]]
        return entities.names[entities.colored_as[number][color]]

    return tuple((renamed(top), renamed(bottom)) for top, bottom in goal)


def _painted(batch: Batch, labels: Labels, permutation: Tensor) -> Tensor:
    """Return the maps (B, rows, columns, 3) with objects in other colors."""
    entities = batch.entities
    colored = _colored(entities)
    own = [entities.color_numbers[number] for number in colored]
    objects = labels.objects[:, colored]
    rows, columns = _windows(batch, objects)
    frames = torch.arange(len(batch), device=rows.device).view(-1, 1, 1)
    cells = (frames, rows, columns)
    old, seen_m = batch.rgb[cells].float() / 255.0, batch.height_m[cells]
    palette = old.new_tensor([OBJECT_COLORS[name][:3] for name in entities.colors])
    source = palette[own][None, :, None]
    target = palette[permutation[:, own]][:, :, None]
    # How bright a cell is beside its palette color says how it is lit.
    light = (old * source).sum(-1, keepdim=True) / (source * source).sum(-1, True)
    above_m = seen_m - objects[..., 2:3]
    inside = _footprints(batch, objects, rows, columns) & batch.coverage[cells]
    traits = traits_of(entities, old.device)
    top_m, height_m = traits.top_m[colored, None], traits.height_m[colored, None]
    inside &= above_m < top_m + _HEIGHT_TOLERANCE_M
    # A white thing in the dark is as grey as the table, which is not so high.
    high = (above_m > top_m - height_m / 2) & (height_m > 2 * _HEIGHT_TOLERANCE_M)
    inside &= _shows_own_color(old, light[..., 0], high, entities)
    new = (light * target * 255.0).round().clamp(0, 255).to(torch.uint8)
    # Cells that are not painted are written behind the last cell.
    height, width = batch.coverage.shape[1:]
    flat = (frames * height + rows) * width + columns
    count = len(batch) * height * width
    flat = torch.where(inside, flat, count)
    image = torch.cat([batch.rgb.reshape(-1, 3), batch.rgb.new_zeros(1, 3)])
    image[flat.reshape(-1)] = new.reshape(-1, 3)
    return image[:-1].view(batch.rgb.shape)


def _windows(batch: Batch, objects: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows and columns of cells around objects, (B, colored, window)."""
    raster = batch.raster
    colored = _colored(batch.entities)
    widest_m = max(batch.entities.kinds[number].disc_m for number in colored)
    reach = int((widest_m + raster.cell_m) / raster.cell_m) + 1
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
    """Return which cells of the windows touch their object, (B, colored, window)."""
    raster = batch.raster
    margin = 0.75 * raster.cell_m
    x = (columns + 0.5 - raster.columns / 2) * raster.cell_m - objects[..., 0:1]
    y = (raster.rows / 2 - rows - 0.5) * raster.cell_m - objects[..., 1:2]
    w, _, _, z = objects[..., 3:].unbind(-1)
    yaw = 2.0 * torch.atan2(z, w)[..., None]
    along = torch.cos(yaw) * x + torch.sin(yaw) * y
    across = torch.cos(yaw) * y - torch.sin(yaw) * x
    found = []
    for row, number in enumerate(_colored(batch.entities)):
        over = torch.zeros_like(along[:, row], dtype=torch.bool)
        for part in batch.entities.kinds[number].parts:
            over |= _covers(part, along[:, row], across[:, row], margin)
        found.append(over)
    # Where an entity is missing its pose is NaN, so that nothing is inside.
    return torch.stack(found, 1)


def _covers(part: Part, x: Tensor, y: Tensor, margin_m: float) -> Tensor:
    """Return which positions in an object's frame an upright part of it covers."""
    x, y = x - part.position_m[0], y - part.position_m[1]
    if part.shape == "box":
        half_x, half_y, _ = part.size_m
        return (x.abs() < half_x + margin_m) & (y.abs() < half_y + margin_m)
    return torch.hypot(x, y) < part.size_m[0] + margin_m


def _shows_own_color(
    rgb: Tensor, light: Tensor, high: Tensor, entities: EntitySet
) -> Tensor:
    """Return which cells have their object's color, however they are lit.

    Args:
        rgb: Colors of 0 to 1, (B, colored, window, 3).
        light: How bright cells are beside their object's palette color.
        high: Whether a cell is so high that it is not the table's.
        entities: Entities, in the order of their numbers.
    """
    colors = entities.colors
    palette = (*(OBJECT_COLORS[name] for name in colors), STICK, TABLE)
    references = rgb.new_tensor([color[:3] for color in palette])
    directions = torch.nn.functional.normalize(references, dim=-1)
    nearest = (rgb @ directions.T).argmax(-1)
    table = len(palette) - 1
    own = torch.tensor(
        [entities.color_numbers[number] for number in _colored(entities)],
        device=rgb.device,
    )[:, None]
    shows = nearest == own
    if _WHITE in colors:
        white = colors.index(_WHITE)
        grey = (nearest == white) | (nearest == table)
        shows = torch.where(own == white, grey & ((light > _LEAST_WHITE) | high), shows)
    return shows & (light > _LEAST_LIGHT)


def _colored(entities: EntitySet) -> list[int]:
    """Return the numbers of the entities whose colors change places."""
    alike = enumerate(entities.colored_as)
    return [number for number, row in alike if len(set(row)) > 1]
