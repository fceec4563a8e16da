"""Batches that are drawn, not rendered: squares on a table, with exact labels."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.env.view import View
from lemma.policies.batch import (
    MAX_PAST,
    NOBODY,
    PRIMITIVES,
    STOP,
    Batch,
    Labels,
    with_sub_instructions,
)
from lemma.policies.entities import BENCHMARK
from lemma.policies.interfaces import PolicyInput
from lemma.policies.models.base import Model
from lemma.scene.objects.entity import ENTITIES
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.raster import Raster
from lemma.tasks.language.bank import robot_phrases_in_order

RASTER = Raster(rows=64, columns=96, cell_m=0.025, floor_m=-0.1)
"""A map of the usual extent with large cells."""
TEAM = ("red", "white")
_BASE_X_M = 0.9

_CUBE_M = 0.075
_PAD_M = 0.15

# The tests' networks are tiny: several threads would only wait for each other.
torch.set_num_threads(1)


def drawn_batch(frames: int, seed: int = 0, stop_last: bool = True) -> Batch:
    """Return one episode of a cube of each frame's own that goes onto a pad.

    Args:
        frames: How many.
        seed: Of where everything is.
        stop_last: Whether the last frame says ``stop``.
    """
    rng = np.random.default_rng(seed)
    colors = list(OBJECT_COLORS)
    shape = (frames, RASTER.rows, RASTER.columns)
    rgb = np.full((*shape, 3), 90, np.uint8)
    height_m = np.zeros(shape, np.float32)
    poses = np.full((2, frames, 3), np.nan, np.float32)
    decision = np.full((frames, 4), NOBODY)
    objects = np.full((frames, len(ENTITIES), 7), np.nan, np.float32)
    for i in range(frames):
        for side, name in zip((-1.0, 1.0), TEAM, strict=True):
            arm = (204, 26, 26) if name == "red" else (240, 240, 240)
            _draw(rgb[i], height_m[i], (side * _BASE_X_M, 0.0), 0.2, arm, 0.5)
        robot = i % 2
        cube, pad = rng.permutation(len(colors))[:2]
        pick = np.array([rng.uniform(-0.7, 0.7), rng.uniform(-0.6, -0.15)])
        place = np.array([rng.uniform(-0.7, 0.7), rng.uniform(0.15, 0.6)])
        for xy, color, size_m, top_m in (
            (place, pad, _PAD_M, 0.004),
            (pick, cube, _CUBE_M, 0.05),
        ):
            shade = tuple(round(255 * v) for v in OBJECT_COLORS[colors[color]][:3])
            _draw(rgb[i], height_m[i], xy, size_m, shade, top_m)
        if stop_last and i == frames - 1:
            decision[i, 1] = STOP
            continue
        pick_entity, place_entity = f"{colors[cube]}_cube", f"{colors[pad]}_pad"
        decision[i] = (
            robot,
            PRIMITIVES.index("move"),
            ENTITIES.index(pick_entity),
            BENCHMARK.places.index(place_entity),
        )
        poses[0, i] = (*pick, rng.uniform(-math.pi, math.pi))
        poses[1, i] = (*place, rng.uniform(-math.pi, math.pi))
        for name, xy in ((pick_entity, pick), (place_entity, place)):
            objects[i, ENTITIES.index(name)] = (*xy, 0.025, 1.0, 0.0, 0.0, 0.0)
    labels = Labels(
        episode=torch.zeros(frames, dtype=torch.int64),
        keyframe=torch.arange(frames),
        decision=torch.from_numpy(decision),
        pick_pose=torch.from_numpy(poses[0]),
        place_pose=torch.from_numpy(poses[1]),
        objects=torch.from_numpy(objects),
        bases=torch.tensor([[-_BASE_X_M, 0.0, 0.0], [_BASE_X_M, 0.0, math.pi]]).repeat(
            frames, 1, 1
        ),
        gap_m=torch.full((frames, 2), math.nan),
        arms=torch.zeros(frames, 2, dtype=torch.int64),
        tasks=["pass"] * frames,
        goals=[(("red_cube", "blue_pad"),)] * frames,
        robot_colors=[TEAM] * frames,
        rules=[()] * frames,
        hands=[()] * frames,
        heavy=torch.zeros(frames, len(BENCHMARK), dtype=torch.bool),
        perturbed=torch.zeros(frames, dtype=torch.bool),
    )
    past = np.full((frames, MAX_PAST, 4), NOBODY)
    for i in range(1, frames):
        past[i, :i] = decision[:i][-MAX_PAST:]
    return with_sub_instructions(
        Batch(
            rgb=torch.from_numpy(rgb),
            height_m=torch.from_numpy(height_m),
            coverage=torch.ones(shape, dtype=torch.bool),
            joints=torch.from_numpy(rng.normal(size=(frames, 2, 6))).float(),
            opening_m=torch.full((frames, 2), 0.1),
            past=torch.from_numpy(past),
            instructions=["Put the red cube onto the blue pad."] * frames,
            sub_instructions=[],
            raster=RASTER,
            labels=labels,
        )
    )


def batch_for(model: str) -> Batch:
    """Return a drawn batch of four frames with the labels that a model needs."""
    batch = drawn_batch(4)
    if model == "keypose":
        labels = replace(
            labels_of(batch),
            pick_pose=torch.zeros(4, 3),
            kind_and_height=torch.zeros(4, 2),
        )
        batch = replace(batch, labels=labels)
    return batch


def labels_of(batch: Batch) -> Labels:
    """Return the labels of a batch that has some."""
    assert batch.labels is not None
    return batch.labels


def total(losses: dict[str, Tensor]) -> Tensor:
    """Return the sum of all terms."""
    return torch.stack(list(losses.values())).sum()


def learn_by_heart(model: Model, batch: Batch, steps: int, rate: float = 5e-3) -> None:
    """Train on one batch, ever more slowly."""
    optimizer = torch.optim.Adam(model.parameters(), rate, fused=True)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = rate * (1.0 - step / steps)
        optimizer.zero_grad()
        total(model.loss(batch)).backward()
        optimizer.step()


def gradients(model: torch.nn.Module) -> dict[str, Tensor | None]:
    """Return the gradient of every weight that may change, by name."""
    return {n: p.grad for n, p in model.named_parameters() if p.requires_grad}


def part_of(batch: Batch, rows: list[int]) -> Batch:
    """Return some frames of a batch, in the order that is asked for."""

    def chosen(value: Any) -> Any:
        if isinstance(value, Tensor):
            return value[rows]
        return [value[i] for i in rows] if isinstance(value, list) else value

    labels = batch.labels
    if labels is not None:
        labels = replace(labels, **{n: chosen(v) for n, v in vars(labels).items()})
    fields = {n: chosen(v) for n, v in vars(batch).items() if n != "labels"}
    return replace(batch, labels=labels, **fields)


def inputs_of(batch: Batch) -> list[PolicyInput]:
    """Return what a policy would be given to see the frames, with no past."""
    return [
        PolicyInput(
            batch.instructions[i],
            robot_phrases_in_order(TEAM),
            View(
                batch.rgb[i].numpy(),
                batch.height_m[i].numpy(),
                batch.coverage[i].numpy(),
                batch.joints[i].double().numpy(),
                batch.opening_m[i].double().numpy(),
            ),
        )
        for i in range(len(batch))
    ]


def _draw(
    rgb: NDArray[np.uint8],
    height_m: NDArray[np.float32],
    xy: tuple[float, float] | NDArray[np.float64],
    size_m: float,
    shade: tuple[int, ...],
    top_m: float,
) -> None:
    """Draw a square whose sides follow the axes."""
    row, column = RASTER.pixel_from_world(xy[0] - size_m / 2, xy[1] + size_m / 2)
    cells = round(size_m / RASTER.cell_m)
    area = (slice(row, row + cells), slice(column, column + cells))
    rgb[area] = shade
    height_m[area] = top_m
