"""Exchange of colors in labelled batches: in images, labels, goals and rules.

It paints only cells within an object's true footprint, at its height and in its color.
So an arm, the stick or a cube on top of it keeps its own color.
"""

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch, Labels
from lemma.policies.entities import EntitySet
from lemma.policies.layers import constant, sent
from lemma.scene.objects.entity import HAND
from lemma.scene.objects.kind import Part
from lemma.scene.objects.palette import OBJECT_COLORS, STICK, TABLE
from lemma.tasks.language.template import GoalPairs

_HEIGHT_TOLERANCE_M = 0.010
"""Above the noise of measured heights, below the height of an object."""
_WHITE = "white"
_LEAST_WHITE = 0.72
"""Smallest brightness of white, as a share; the table is half as bright."""
_LEAST_LIGHT = 0.12
"""Smallest brightness of a cell with a recognisable color."""


def permute_colors(batch: Batch, permutation: Tensor) -> Batch:
    """Return a batch with permuted colors and unchanged instructions.

    Args:
        batch: Batch with labels; only its maps may be on a GPU.
        permutation: Index into ``batch.entities.colors`` of the new color by index of
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
            heavy=_reordered(labels.heavy[..., None], tables).squeeze(2),
            goals=goals,
            rules=[
                rule and _rule_anew(rule, entities, tuple(new))
                for rule, new in zip(labels.rules, permutation.tolist(), strict=True)
            ],
        ),
    )


def _entity_tables(permutation: Tensor, entities: EntitySet) -> Tensor:
    """Return the new numbers of entities, regions and no entity, (B, places + 1)."""
    alike = torch.tensor(entities.colored_as)
    color = permutation[:, list(entities.color_numbers)]
    numbers = alike.expand(len(color), -1, -1).gather(2, color[..., None]).squeeze(2)
    regions = range(len(entities), len(entities.places))
    rest = torch.tensor([*regions, NOBODY])
    return torch.cat([numbers, rest.expand(len(permutation), -1)], 1)


def _renamed(decisions: Tensor, tables: Tensor) -> Tensor:
    """Return decisions (B, ..., 4) with the new colors."""
    named = decisions[..., 2:].reshape(len(decisions), -1)
    # -1, no entity, is the last row of a table.
    new = tables.gather(1, named % tables.shape[1]).view(decisions[..., 2:].shape)
    return torch.cat([decisions[..., :2], new], -1)


def _reordered(objects: Tensor, tables: Tensor) -> Tensor:
    """Return values of entities (B, E, ...), in the rows of the new colors."""
    rows = tables[:, : objects.shape[1], None].expand_as(objects)
    return torch.empty_like(objects).scatter_(1, rows, objects)


@lru_cache(maxsize=65536)
def _said_anew(goal: GoalPairs, entities: EntitySet, new: tuple[int, ...]) -> GoalPairs:
    return tuple(
        (_recolored(top, entities, new), _recolored(bottom, entities, new))
        for top, bottom in goal
    )


def _rule_anew(
    rule: tuple[str, ...], entities: EntitySet, new: tuple[int, ...]
) -> tuple[str, ...]:
    return tuple(
        _recolored(name, entities, new) if name in entities.names else name
        for name in rule
    )


def _recolored(entity: str, entities: EntitySet, new: tuple[int, ...]) -> str:
    """Return the name of an entity after an exchange of colors."""
    if entity == HAND:
        return entity
    number = entities.number(entity)
    color = new[entities.color_numbers[number]]
    return entities.names[entities.colored_as[number][color]]


def _painted(batch: Batch, labels: Labels, permutation: Tensor) -> Tensor:
    """Return the maps (B, rows, columns, 3) with objects in other colors."""
    entities = batch.entities
    colored = _colored(entities)
    own = [entities.color_numbers[number] for number in colored]
    device = batch.rgb.device
    palette = torch.tensor([OBJECT_COLORS[name][:3] for name in entities.colors])
    source = sent(palette[own][None, :, None], device)
    target = sent(palette[permutation[:, own]][:, :, None], device)
    objects = sent(labels.objects[:, colored], device)
    rows, columns = _windows(batch, objects)
    frames = torch.arange(len(batch), device=device).view(-1, 1, 1)
    cells = (frames, rows, columns)
    old, seen_m = batch.rgb[cells].float() / 255.0, batch.height_m[cells]
    # The brightness relative to the palette color is the lighting of a cell.
    light = (old * source).sum(-1, keepdim=True) / (source * source).sum(-1, True)
    above_m = seen_m - objects[..., 2:3]
    inside = _footprints(batch, objects, rows, columns) & batch.coverage[cells]
    kinds = [entities.kinds[number] for number in colored]
    top_m = constant(tuple((kind.top_m,) for kind in kinds), device)
    height_m = constant(tuple((kind.height_m,) for kind in kinds), device)
    inside &= above_m < top_m + _HEIGHT_TOLERANCE_M
    # A dark white object is as grey as the table, so use the height as well.
    high = (above_m > top_m - height_m / 2) & (height_m > 2 * _HEIGHT_TOLERANCE_M)
    inside &= _shows_own_color(old, light[..., 0], high, entities)
    new = (light * target * 255.0).round().clamp(0, 255).to(torch.uint8)
    # Cells that keep their color are written to an extra cell behind the last one.
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
    # Cells outside of the map become border cells, which are not in a footprint.
    return rows.clamp(0, raster.rows - 1), columns.clamp(0, raster.columns - 1)


def _footprints(batch: Batch, objects: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Return whether cells of the windows touch their object, (B, colored, window)."""
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
    # A missing entity has the pose NaN, so no cell is inside.
    return torch.stack(found, 1)


def _covers(part: Part, x: Tensor, y: Tensor, margin_m: float) -> Tensor:
    """Return whether an upright part covers positions in its object's frame."""
    x, y = x - part.position_m[0], y - part.position_m[1]
    if part.shape == "box":
        half_x, half_y, _ = part.size_m
        return (x.abs() < half_x + margin_m) & (y.abs() < half_y + margin_m)
    return torch.hypot(x, y) < part.size_m[0] + margin_m


def _shows_own_color(
    rgb: Tensor, light: Tensor, high: Tensor, entities: EntitySet
) -> Tensor:
    """Return whether cells have their object's color, in any lighting.

    Args:
        rgb: Colors of 0 to 1, (B, colored, window, 3).
        light: Brightness of cells relative to their object's palette color.
        high: Whether cells are above the table.
        entities: Entities, in the order of their numbers.
    """
    colors = entities.colors
    palette = (*(OBJECT_COLORS[name] for name in colors), STICK, TABLE)
    references = constant(tuple(tuple(color[:3]) for color in palette), rgb.device)
    directions = torch.nn.functional.normalize(references, dim=-1)
    nearest = (rgb @ directions.T).argmax(-1)
    table = len(palette) - 1
    numbers = [entities.color_numbers[number] for number in _colored(entities)]
    own = constant(tuple(numbers), rgb.device)[:, None]
    shows = nearest == own
    if _WHITE in colors:
        white = colors.index(_WHITE)
        grey = (nearest == white) | (nearest == table)
        shows = torch.where(own == white, grey & ((light > _LEAST_WHITE) | high), shows)
    return shows & (light > _LEAST_LIGHT)


def _colored(entities: EntitySet) -> list[int]:
    """Return the numbers of the entities with an exchangeable color."""
    alike = enumerate(entities.colored_as)
    return [number for number, row in alike if len(set(row)) > 1]
