"""Augmentation of batches, with exact labels.

All frames of an episode get the same changes, because models see them together. An
exchange of colors paints only cells within an object's true footprint, at its height
and in its color. So an arm, the stick or a cube on top of it keeps its own color.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from lemma.policies.batch import NOBODY, Batch, Labels, with_sub_instructions
from lemma.policies.entities import EntitySet, traits_of
from lemma.policies.models.grid import wrapped
from lemma.policies.models.reachnet.scene_table import turned_numbers
from lemma.policies.training.config import Augmentation
from lemma.scene.objects.entity import HAND
from lemma.scene.objects.kind import Part
from lemma.scene.objects.palette import OBJECT_COLORS, STICK, TABLE
from lemma.tasks.language.template import GoalPairs

HOLE_CELLS = (2, 8)
"""Smallest and largest side of a hole in the images."""
_HEIGHT_TOLERANCE_M = 0.010
"""Above the noise of measured heights, below the height of an object."""
_WHITE = "white"
_LEAST_WHITE = 0.72
"""Smallest brightness of white, as a share; the table is half as bright."""
_LEAST_LIGHT = 0.12
"""Smallest brightness of a cell with a recognisable color."""


def augment(batch: Batch, options: Augmentation, rng: np.random.Generator) -> Batch:
    """Return a randomly augmented batch; instructions are drawn elsewhere.

    Args:
        batch: Batch with labels, on any device.
        options: Changes to draw.
        rng: Random generator.
    """
    assert batch.labels is not None
    episodes, numbers = np.unique(batch.labels.episode.cpu(), return_inverse=True)
    count, device = len(episodes), batch.rgb.device

    def each(values: Any) -> Tensor:
        """Expand values of the episodes to values of the frames."""
        return torch.from_numpy(np.asarray(values)[numbers]).to(device)

    if options.palette:
        colors = len(batch.entities.colors)
        batch = permute_colors(
            batch, each(rng.permuted(np.tile(np.arange(colors), (count, 1)), axis=1))
        )
    cells = options.translate_cells
    if options.turn or cells:
        shift = rng.integers(-cells, cells + 1, (count, 2))
        turned = rng.random(count) < 0.5 * options.turn
        batch = move(batch, each(shift), each(turned))
    generator = torch.Generator(device)
    generator.manual_seed(int(rng.integers(2**62)))
    if options.brightness or options.pixel_noise:
        amounts = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        batch = _noisy_colors(batch, options, each(amounts), generator)
    if options.height_noise_m:
        amount = rng.uniform(0.0, options.height_noise_m, count).astype(np.float32)
        batch = _noisy_heights(batch, each(amount), generator)
    if options.dropouts:
        batch = _with_holes(batch, options.dropouts, rng)
    return with_sub_instructions(batch)


def move(batch: Batch, shift: Tensor, turned: Tensor) -> Batch:
    """Return a batch with scenes turned by half a turn, then shifted.

    In turned scenes the two robots of a pair exchange numbers, because the first robot
    is at -x; those of larger teams keep theirs. Cells that enter at the border are not
    covered.

    Args:
        batch: Batch with labels.
        shift: Shift along rows and columns in cells, (B, 2) int64.
        turned: Whether each frame is turned, (B,) bool.
    """
    labels, raster = batch.labels, batch.raster
    assert labels is not None
    robots = labels.bases.shape[1]
    swapped = turned & (robots == 2)
    rows, rows_seen = _sources(raster.rows, shift[:, 0], turned)
    columns, columns_seen = _sources(raster.columns, shift[:, 1], turned)
    frames = torch.arange(len(batch), device=rows.device)[:, None, None]
    cells = (frames, rows[:, :, None], columns[:, None, :])
    seen = rows_seen[:, :, None] & columns_seen[:, None, :]
    sign = torch.where(turned, -1.0, 1.0)
    # Row numbers increase towards -y.
    offset = torch.stack([shift[:, 1], -shift[:, 0]], 1) * raster.cell_m

    def flat(poses: Tensor) -> Tensor:
        """Return the poses (B, ..., 3) in the plane after the motion."""
        extra = (1,) * (poses.ndim - 2)
        xy = poses[..., :2] * sign.view(-1, *extra, 1) + offset.view(-1, *extra, 2)
        yaw = wrapped(poses[..., 2] + turned.view(-1, *extra) * torch.pi)
        return torch.cat([xy, yaw[..., None]], -1)

    moved = replace(
        labels,
        pick_pose=flat(labels.pick_pose),
        place_pose=flat(labels.place_pose),
        objects=_moved_objects(labels.objects, sign, offset, turned),
        bases=_swapped(flat(labels.bases), swapped),
        gap_m=(labels.gap_m * sign[:, None] + offset[:, :1]).sort(1).values,
        arms=_swapped(labels.arms, swapped),
        decision=_renumbered(labels.decision, swapped, robots),
        robot_colors=[
            colors[::-1] if turn else colors
            for colors, turn in zip(labels.robot_colors, swapped.tolist(), strict=True)
        ],
    )
    return replace(
        batch,
        rgb=batch.rgb[cells] * seen[..., None],
        height_m=batch.height_m[cells] * seen,
        coverage=batch.coverage[cells] & seen,
        joints=_swapped(batch.joints, swapped),
        opening_m=_swapped(batch.opening_m, swapped),
        past=_renumbered(batch.past, swapped, robots),
        labels=moved,
    )


def _sources(size: int, shift: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
    """Return the source rows or columns, (B, size), and whether they exist."""
    places = torch.arange(size, device=shift.device) - shift[:, None]
    seen = (places >= 0) & (places < size)
    places = torch.where(turned[:, None], size - 1 - places, places)
    return places.clamp(0, size - 1), seen


def _moved_objects(
    objects: Tensor, sign: Tensor, offset: Tensor, turned: Tensor
) -> Tensor:
    """Return positions and quaternions (B, entities, 7) of a moved scene."""
    xy = objects[..., :2] * sign[:, None, None] + offset[:, None]
    w, x, y, z = objects[..., 3:].unbind(-1)
    # Half a turn about z, (0, 0, 0, 1), times the quaternion.
    after = torch.stack([-z, -y, x, w], -1)
    quaternion = torch.where(turned[:, None, None], after, objects[..., 3:])
    return torch.cat([xy, objects[..., 2:3], quaternion], -1)


def _swapped(values: Tensor, turned: Tensor) -> Tensor:
    """Return values of robots (B, R, ...), in reverse order in turned scenes."""
    extra = (1,) * (values.ndim - 1)
    return torch.where(turned.view(-1, *extra), values.flip(1), values)


def _renumbered(decisions: Tensor, turned: Tensor, robots: int) -> Tensor:
    """Return decisions (B, ..., 4), with exchanged robots in turned scenes."""
    extra = (1,) * (decisions.ndim - 1)
    others = turned_numbers(decisions, robots)
    return torch.where(turned.view(-1, *extra), others, decisions)


def _noisy_colors(
    batch: Batch, options: Augmentation, amounts: Tensor, generator: torch.Generator
) -> Batch:
    """Change brightness, contrast and each color; ``amounts`` (B, 3) in -1 to 1."""
    brightness, contrast, noise = amounts.unbind(1)
    scale = 1.0 + options.brightness * contrast
    offset = 255.0 * options.brightness * brightness * 0.5 + 127.5 * (1.0 - scale)
    spread = 255.0 * options.pixel_noise * noise.abs()
    rgb = batch.rgb * scale.view(-1, 1, 1, 1) + offset.view(-1, 1, 1, 1)
    if options.pixel_noise:
        drawn = torch.randn(rgb.shape, generator=generator, device=rgb.device)
        rgb = rgb + drawn * spread.view(-1, 1, 1, 1)
    rgb = rgb.round().clamp(0, 255).to(torch.uint8)
    return replace(batch, rgb=rgb * batch.coverage[..., None])


def _noisy_heights(batch: Batch, amount: Tensor, generator: torch.Generator) -> Batch:
    """Change each height; ``amount`` (B,) is the standard deviation [m]."""
    height = batch.height_m
    drawn = torch.randn(height.shape, generator=generator, device=height.device)
    noisy = height + drawn * amount.view(-1, 1, 1)
    return replace(batch, height_m=torch.where(batch.coverage, noisy, 0.0))


def _with_holes(batch: Batch, most: int, rng: np.random.Generator) -> Batch:
    """Remove up to ``most`` small rectangles from each frame's images."""
    count, (height, width) = len(batch), batch.coverage.shape[1:]
    sides = rng.integers(HOLE_CELLS[0], HOLE_CELLS[1] + 1, (2, count, most))
    # A hole of size 0 is no hole.
    sides *= np.arange(most) < rng.integers(0, most + 1, (count, 1))
    starts = rng.integers(0, [[[height]], [[width]]], (2, count, most))
    device = batch.rgb.device

    inside = []
    for size, start, side in zip((height, width), starts, sides, strict=True):
        past = np.arange(size) - start[..., None]
        inside.append((past >= 0) & (past < side[..., None]))
    rows, columns = (torch.from_numpy(one).to(device).float() for one in inside)
    kept = batch.coverage & (rows.transpose(1, 2) @ columns == 0)
    return replace(
        batch,
        rgb=batch.rgb * kept[..., None],
        height_m=batch.height_m * kept,
        coverage=kept,
    )


def permute_colors(batch: Batch, permutation: Tensor) -> Batch:
    """Return a batch with permuted colors and unchanged instructions.

    Args:
        batch: Batch with labels.
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
            goals=goals,
            rules=[
                rule and _rule_anew(rule, entities, tuple(new))
                for rule, new in zip(labels.rules, permutation.tolist(), strict=True)
            ],
        ),
    )


def _entity_tables(permutation: Tensor, entities: EntitySet) -> Tensor:
    """Return the new numbers of entities, regions and no entity, (B, places + 1)."""
    device = permutation.device
    alike = torch.tensor(entities.colored_as, device=device)
    color = permutation[:, list(entities.color_numbers)]
    numbers = alike.expand(len(color), -1, -1).gather(2, color[..., None]).squeeze(2)
    regions = range(len(entities), len(entities.places))
    rest = torch.tensor([*regions, NOBODY], device=device)
    return torch.cat([numbers, rest.expand(len(permutation), -1)], 1)


def _renamed(decisions: Tensor, tables: Tensor) -> Tensor:
    """Return decisions (B, ..., 4) with the new colors."""
    named = decisions[..., 2:].reshape(len(decisions), -1)
    # -1, no entity, is the last row of a table.
    new = tables.gather(1, named % tables.shape[1]).view(decisions[..., 2:].shape)
    return torch.cat([decisions[..., :2], new], -1)


def _reordered(objects: Tensor, tables: Tensor) -> Tensor:
    """Return true poses (B, E, 7), in the rows of the new colors."""
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
    objects = labels.objects[:, colored]
    rows, columns = _windows(batch, objects)
    frames = torch.arange(len(batch), device=rows.device).view(-1, 1, 1)
    cells = (frames, rows, columns)
    old, seen_m = batch.rgb[cells].float() / 255.0, batch.height_m[cells]
    palette = old.new_tensor([OBJECT_COLORS[name][:3] for name in entities.colors])
    source = palette[own][None, :, None]
    target = palette[permutation[:, own]][:, :, None]
    # The brightness relative to the palette color is the lighting of a cell.
    light = (old * source).sum(-1, keepdim=True) / (source * source).sum(-1, True)
    above_m = seen_m - objects[..., 2:3]
    inside = _footprints(batch, objects, rows, columns) & batch.coverage[cells]
    traits = traits_of(entities, old.device)
    top_m, height_m = traits.top_m[colored, None], traits.height_m[colored, None]
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
    references = rgb.new_tensor([color[:3] for color in palette])
    directions = torch.nn.functional.normalize(references, dim=-1)
    nearest = (rgb @ directions.T).argmax(-1)
    table = len(palette) - 1
    numbers = [entities.color_numbers[number] for number in _colored(entities)]
    own = torch.tensor(numbers, device=rgb.device)[:, None]
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
