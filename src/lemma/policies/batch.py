"""Batches of frames with labels, as tensors on one device, for every model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_number
from lemma.policies.entities import BENCHMARK, EntitySet
from lemma.policies.interfaces import PolicyInput
from lemma.policies.layers import sent
from lemma.policies.text.lessons import Lesson
from lemma.scene.raster import Raster
from lemma.tasks.language.bank import robot_phrases_in_order, sub_instruction
from lemma.tasks.language.template import GoalPairs
from lemma.tasks.subtask import PAPER_PRIMITIVES

PRIMITIVES = tuple(map(str, PAPER_PRIMITIVES))
STOP = PRIMITIVES.index("stop")
NOBODY = -1
"""Number for no robot and no entity, as in ``stop`` and in padding."""
MAX_PAST = 12
"""Largest number of past decisions in a batch; older ones are left out."""


@dataclass(frozen=True, eq=False)
class Batch:
    """B frames of R robots, with labels in training.

    Tensors are on one device, but see :meth:`lemma.policies.frames.Frames.batch`.
    """

    rgb: Tensor
    """(B, rows, columns, 3) uint8."""
    height_m: Tensor
    """(B, rows, columns) float32 [m]; 0 in cells that no camera sees."""
    coverage: Tensor
    """Whether a camera sees the cell, (B, rows, columns) bool."""
    joints: Tensor
    """(B, R, 6) float32 [rad]."""
    opening_m: Tensor
    """(B, R) float32 [m]."""
    past: Tensor
    """Decisions that were executed before this one, oldest first, padded with -1 at
    the end: (B, MAX_PAST, 4) int64, columns robot, primitive, pick, place. In perturbed
    executions they differ from the expert's decisions."""
    instructions: list[str]
    sub_instructions: list[str]
    """The next sub-task in words; at inference, the sub-task to ground."""
    raster: Raster
    entities: EntitySet = BENCHMARK
    """Entities that have a number in decisions and labels; E of them."""
    labels: "Labels | None" = None
    """Decisions of the expert and the true state; None at inference."""
    lesson: Lesson | None = None
    """Sentences for the reader alone, which a training step adds to those of the
    frames; None for none."""
    text_tensors: Mapping[str, Tensor] = field(default_factory=dict)
    """Texts and names as tensors, from the model's method of this name, if any."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.rgb)


@dataclass(frozen=True, eq=False)
class Labels:
    """The expert's next decision and the true poses, in the world frame.

    In data with teams of different sizes, R is the largest size, and the rows of robots
    that are not there have no meaning.
    """

    episode: Tensor
    """Number of the episode in the data set, (B,)."""
    keyframe: Tensor
    """Number of the frame in its episode, from 0, (B,)."""
    decision: Tensor
    """(B, 4) int64: robot, primitive, pick, place. For ``stop`` all but the primitive
    are -1."""
    pick_pose: Tensor
    """Gripper's pose where it closes: x, y [m], yaw [rad], (B, 3); NaN for stop."""
    place_pose: Tensor
    """Gripper's pose where the motion ends, (B, 3); NaN for stop."""
    objects: Tensor
    """True position [m] and quaternion wxyz of each entity, (B, E, 7); NaN if none."""
    bases: Tensor
    """x, y [m], yaw [rad] of each robot, (B, R, 3). Never an input."""
    gap_m: Tensor
    """World x of both edges of the gap in the table [m], (B, 2); NaN without a gap."""
    arms: Tensor
    """Index into :data:`ARMS` of each robot's type, (B, R). Never an input."""
    tasks: list[str]
    goals: list[GoalPairs]
    """The (top, bottom) entities that the instruction asks for."""
    robot_colors: list[tuple[str, ...]]
    rules: list[tuple[str, ...]]
    """The rule of each goal (:mod:`lemma.tasks.teams.rule`); empty without one."""
    hands: list[tuple[str, ...]]
    """Names of the robots' hands; empty where all have the standard one."""
    heavy: Tensor
    """Whether entities have a mass of their own, (B, E) bool: they are heavy."""
    perturbed: Tensor
    """Whether the frames also depend on a perturbation, (B,) bool."""
    kind_and_height: Tensor | None = None
    """Only in data of key poses: index into ``KINDS`` and height [m], (B, 2);
    ``pick_pose`` and ``place_pose`` are then the key pose."""


def batch_of(
    inputs: Sequence[PolicyInput],
    raster: Raster,
    sub_instructions: Sequence[str] = (),
    device: torch.device | str = "cpu",
    entities: EntitySet = BENCHMARK,
) -> Batch:
    """Return inputs of a policy as a batch, without labels.

    Args:
        inputs: One per frame.
        raster: Raster of their maps.
        sub_instructions: Sub-instructions to ground, if any.
        device: Device of the batch.
        entities: Entities, in the order of their numbers.

    Raises:
        InvalidConfigError: A past decision moved an entity without a number.
    """
    past = np.full((len(inputs), MAX_PAST, 4), NOBODY)
    for row, policy_input in enumerate(inputs):
        for column, step in enumerate(policy_input.past[-MAX_PAST:]):
            past[row, column] = decision_numbers(step.subtask.to_dict(), entities)
    views = [policy_input.view for policy_input in inputs]

    def stacked(name: str, dtype: torch.dtype) -> Tensor:
        array = np.stack([getattr(view, name) for view in views])
        return torch.from_numpy(array).to(device, dtype)

    return Batch(
        rgb=stacked("rgb", torch.uint8),
        height_m=stacked("height_m", torch.float32),
        coverage=stacked("coverage", torch.bool),
        joints=stacked("joints", torch.float32),
        opening_m=stacked("opening_m", torch.float32),
        past=torch.from_numpy(past).to(device),
        instructions=[policy_input.instruction for policy_input in inputs],
        sub_instructions=list(sub_instructions),
        raster=raster,
        entities=entities,
    )


def check_gpu() -> None:
    """Check that torch finds a GPU.

    Raises:
        InvalidConfigError: It finds none.
    """
    if not torch.cuda.is_available():
        raise InvalidConfigError(
            "No GPU is available: torch finds no CUDA device. Leave out --device, or "
            "install a torch that is built for this machine's driver."
        )


def moved(batch: Batch, device: torch.device) -> Batch:
    """Return a batch with all its tensors on a device."""

    def there(part: Any) -> dict[str, Any]:
        values = {f.name: getattr(part, f.name) for f in fields(part)}
        return {n: sent(v, device) for n, v in values.items() if isinstance(v, Tensor)}

    labels = batch.labels and replace(batch.labels, **there(batch.labels))
    return replace(batch, **there(batch), labels=labels)


def with_sub_instructions(batch: Batch) -> Batch:
    """Return a labelled batch with its labels' sub-tasks as sub-instructions."""
    assert batch.labels is not None
    texts, places = [], batch.entities.places
    rows = batch.labels.decision.tolist()
    for row, colors in zip(rows, batch.labels.robot_colors, strict=True):
        robot, primitive, pick, place = row
        if primitive == STOP:
            texts.append(sub_instruction("", "stop"))
            continue
        texts.append(
            sub_instruction(
                robot_phrases_in_order(colors)[robot],
                PRIMITIVES[primitive],
                places[pick],
                places[place],
            )
        )
    return replace(batch, sub_instructions=texts)


def decision_numbers(
    subtask: dict[str, str], entities: EntitySet = BENCHMARK
) -> list[int]:
    """Return a sub-task as numbers: robot, primitive, pick, place; -1 for none.

    Raises:
        InvalidConfigError: An entity or the primitive has no number.
    """
    if subtask["primitive"] not in PRIMITIVES:
        raise InvalidConfigError(
            f"Trained models know {', '.join(PRIMITIVES)}, and no "
            f"{subtask['primitive']!r}. Leave out the tasks that need it."
        )
    pick, place = subtask["pick"], subtask["place"]
    return [
        robot_number(subtask["robot"]) if subtask["robot"] else NOBODY,
        PRIMITIVES.index(subtask["primitive"]),
        entities.number(pick) if pick else NOBODY,
        entities.number(place) if place else NOBODY,
    ]
