"""All keyframes of a split as tensors, from which a training loop draws batches."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lemma.core.errors import DatasetError
from lemma.dataset.rendered.dataset import POLICY_COLUMNS, MapsInMemory, keyframe_shards
from lemma.dataset.rendered.keyframes import EXECUTED
from lemma.env.control.key_poses import KINDS
from lemma.policies.batch import (
    MAX_PAST,
    NOBODY,
    PRIMITIVES,
    Batch,
    Labels,
    decision_numbers,
    with_sub_instructions,
)
from lemma.policies.entities import BENCHMARK, EntitySet, poses_of
from lemma.policies.layers import sent
from lemma.robots.ur.arms import ARMS
from lemma.scene.raster import UNIT_M

_ARMS = tuple(ARMS)
_SEEN = ("joints", "opening_m")
_POSES = ("pick_pose", "place_pose", "bases", "kind_and_height")
_DECISION = ("robot", "primitive", "pick", "place")
_COLUMNS = (*POLICY_COLUMNS, "objects", "goal", "instance")


class Frames:
    """All keyframes of a split, ready for a training loop."""

    def __init__(
        self,
        maps: MapsInMemory,
        device: torch.device | str = "cpu",
        entities: EntitySet = BENCHMARK,
    ) -> None:
        """Move maps to a device; they take 5 bytes per cell.

        Args:
            maps: Maps with the columns of :meth:`load`.
            device: Device of the maps. All other tensors stay on the CPU.
            entities: Entities, in the order of their numbers.

        Raises:
            InvalidConfigError: A decision moves an entity without a number.
        """
        columns, self.entities = _with_key_poses(maps.columns), entities
        self.raster = maps.raster
        self.device = torch.device(device)
        self.rgb = torch.from_numpy(maps.rgb).to(self.device)
        # 0.1 mm in 16 bits: signed, because torch knows few operations on uint16.
        self.height = torch.from_numpy(maps.height.view(np.int16)).to(self.device)
        self.tasks = [str(task) for task in columns["task"]]
        self.instances = [
            (task, int(index))
            for task, index in zip(self.tasks, columns["index"], strict=True)
        ]
        instances = [json.loads(text) for text in columns["instance"]]
        goals = [json.loads(goal) for goal in columns["goal"]]
        self._instructions = [str(text) for text in columns["instruction"]]
        self._lists: dict[str, list[Any]] = {
            "tasks": self.tasks,
            "goals": [tuple((top, bottom) for top, bottom in goal) for goal in goals],
            "robot_colors": [tuple(c for _, c, *_ in i["robots"]) for i in instances],
            "rules": [tuple(i.get("rule") or ()) for i in instances],
            "hands": [tuple(i.get("hands", ())) for i in instances],
        }
        perturbed = f"{EXECUTED}robot" in columns
        decisions = _decisions(columns, entities)
        executed = _decisions(columns, entities, EXECUTED) if perturbed else decisions
        arms = _padded(
            [[_ARMS.index(n) for n in s.split("+")] for s in columns["arms"]]
        )
        keyframe = self._tensor(columns["keyframe"], torch.int64)
        gaps = [instance.get("gap_m") or (np.nan, np.nan) for instance in instances]
        self._tensors = {
            "episode": torch.cumsum((keyframe == 0).long(), 0) - 1,
            "keyframe": keyframe,
            "decision": self._tensor(decisions, torch.int64),
            "past": self._tensor(_pasts(columns, executed), torch.int64),
            "arms": self._tensor(arms, torch.int64),
            "objects": self._tensor(columns["objects"], torch.float32),
            "gap_m": self._tensor(gaps, torch.float32),
            "heavy": self._tensor(_heavy(instances, entities), torch.bool),
            "perturbed": self._tensor([perturbed] * len(decisions), torch.bool),
            **{
                name: self._tensor(_padded(columns[name]), torch.float32)
                for name in filter(columns.__contains__, (*_SEEN, *_POSES))
            },
        }

    @classmethod
    def load(
        cls,
        folder: str | Path,
        split: str = "train",
        tasks: Sequence[str] = (),
        device: torch.device | str = "cpu",
        entities: EntitySet = BENCHMARK,
        *,
        shared: bool = False,
        mixed: bool = False,
    ) -> "Frames":
        """Read a folder that ``lemma render --form keyframes`` wrote.

        Args:
            folder: The rendered keyframes.
            split: Name of a split.
            tasks: Names of tasks; all if empty.
            device: Device of the maps. All other tensors stay on the CPU.
            entities: Entities, in the order of their numbers.
            shared: Whether processes of this machine share the maps; see
                :class:`~lemma.dataset.rendered.dataset.MapsInMemory`.
            mixed: Whether teams may have different sizes.

        Raises:
            DatasetError: Files are missing, damaged or of another version, scenes have
                different numbers of robots, or a scene has an entity without a number.
            InvalidConfigError: A decision moves an entity without a number.
        """
        columns: tuple[str, ...] = _COLUMNS
        shards = keyframe_shards(Path(folder), split, tasks)
        header = shards[0].header
        if header.perturbed:
            columns += tuple(f"{EXECUTED}{name}" for name in _DECISION)
        columns += ("kind", "key_pose") if header.key_poses else ()
        maps = MapsInMemory.load(folder, split, tasks, columns, shared=shared)
        if not mixed and len({np.shape(j) for j in maps.columns["joints"]}) > 1:
            raise DatasetError(
                f"{folder} mixes teams of different sizes. Choose tasks of one size."
            )
        poses, at = [], 0
        for header in (shard.header for shard in shards):
            rows = list(maps.columns["objects"][at : at + sum(header.keyframes)])
            poses.append(poses_of(np.stack(rows), header.entities, entities))
            at += len(rows)
        maps.columns["objects"] = np.concatenate(poses)
        return cls(maps, device, entities)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.rgb)

    @property
    def episodes(self) -> list[range]:
        """The frames of each episode, in order."""
        starts = torch.nonzero(self._tensors["keyframe"] == 0).flatten().tolist()
        ends = [*starts[1:], len(self)]
        return [range(a, b) for a, b in zip(starts, ends, strict=True)]

    @property
    def robots(self) -> int:
        """Number of robots of every scene."""
        return self._tensors["arms"].shape[1]

    def batch(
        self, indices: Tensor | Sequence[int], device: torch.device | None = None
    ) -> Batch:
        """Return frames with labels and the recorded instructions.

        Only the maps are on a GPU: augmentation and sentences are made from all other
        tensors, which :func:`lemma.policies.batch.moved` sends afterwards.

        Args:
            indices: Indices of the frames, (B,), in any order.
            device: Device of the maps; that of the frames if None.
        """
        device = device or self.device
        rows = torch.as_tensor(indices)
        listed = rows.tolist()
        # Send heights as 16-bit integers: float32 has twice as many bytes.
        rgb = _picked(self.rgb, rows, device)
        height = _picked(self.height, rows, device)
        coverage = height != 0
        height_m = height.float() * UNIT_M + (self.raster.floor_m - UNIT_M)
        tensors = {name: tensor[rows] for name, tensor in self._tensors.items()}
        seen: dict[str, Any] = {n: tensors.pop(n) for n in (*_SEEN, "past")}
        lists = {name: [v[i] for i in listed] for name, v in self._lists.items()}
        return with_sub_instructions(
            Batch(
                rgb=rgb,
                height_m=torch.where(coverage, height_m, 0.0),
                coverage=coverage,
                **seen,
                instructions=[self._instructions[i] for i in listed],
                sub_instructions=[],
                raster=self.raster,
                entities=self.entities,
                labels=Labels(**tensors, **lists),  # type: ignore[arg-type]
            )
        )

    @staticmethod
    def _tensor(values: Any, dtype: torch.dtype) -> Tensor:
        return torch.as_tensor(np.asarray(values)).to(dtype)


def _picked(images: Tensor, rows: Tensor, device: torch.device) -> Tensor:
    """Return some images, (B, ...), on a device; ``rows`` are on the CPU."""
    if images.device.type == device.type:
        return images.index_select(0, sent(rows, device))
    # Pinned memory is kept for later batches. New memory for each batch would take
    # several times as long as the copy.
    shape, pinned = (len(rows), *images.shape[1:]), device.type == "cuda"
    found = torch.empty(shape, dtype=images.dtype, pin_memory=pinned)
    torch.index_select(images, 0, rows, out=found)
    return found.to(device, non_blocking=True)


def _heavy(
    instances: Sequence[dict[str, Any]], entities: EntitySet
) -> list[list[bool]]:
    masses: list[dict[str, float]] = [one.get("masses_kg", {}) for one in instances]
    return [[name in heavy for name in entities.names] for heavy in masses]


def _padded(rows: Sequence[Any]) -> NDArray[Any]:
    """Stack rows of different lengths, with zeros at the ends of shorter ones."""
    arrays = [np.asarray(row) for row in rows]
    longest = max(len(array) for array in arrays)
    found = np.zeros((len(arrays), longest, *arrays[0].shape[1:]), arrays[0].dtype)
    for row, array in zip(found, arrays, strict=True):
        row[: len(array)] = array
    return found


def _with_key_poses(columns: dict[str, Any]) -> dict[str, Any]:
    """Return columns whose pick and place poses are the key poses, if there are any."""
    if "kind" not in columns:
        return columns
    x, y, z, yaw = np.stack(list(columns["key_pose"])).T
    kinds = [KINDS.index(kind) for kind in columns["kind"]]
    pose, last = np.stack([x, y, yaw], 1), np.stack([kinds, z], 1)
    # Other primitives have no number; the kind of key pose distinguishes them.
    known = [name if name in PRIMITIVES else "move" for name in columns["primitive"]]
    poses = {"pick_pose": pose, "place_pose": pose, "kind_and_height": last}
    return {**columns, **poses, "primitive": np.array(known, object)}


def _decisions(
    columns: dict[str, Any], entities: EntitySet, prefix: str = ""
) -> list[list[int]]:
    return [
        decision_numbers(
            {name: columns[prefix + name][i] for name in _DECISION}, entities
        )
        for i in range(len(columns["robot"]))
    ]


def _pasts(columns: dict[str, Any], decisions: list[list[int]]) -> Any:
    past = np.full((len(decisions), MAX_PAST, 4), NOBODY)
    for i, keyframe in enumerate(columns["keyframe"]):
        done = decisions[i - int(keyframe) : i][-MAX_PAST:]
        if done:
            past[i, : len(done)] = done
    return past
