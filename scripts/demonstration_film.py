"""Pictures of demonstrations as arrays, and samples of them for learning.

:func:`film` executes a recipe again and writes what ``lemma render --form lerobot``
would, frame by frame, as arrays instead of videos; :class:`Film` holds all of it on the
device that computes, so nothing waits for a disk, a decoder or a copy.
"""

import json
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lemma.core.files import sha256_of
from lemma.core.workers.pool import ProcessPool
from lemma.dataset.files import MANIFEST
from lemma.dataset.lerobot.export import LeRobotConfig, Shard
from lemma.dataset.lerobot.frames import Style, frames
from lemma.dataset.lerobot.sources import check_source, read_records
from lemma.dataset.rendered.render import RenderConfig
from side_by_side import visible_gpus

ABOUT, LENGTHS = "about.json", "lengths"
VECTORS = (OBS_STATE, OBS_ENV_STATE, ACTION)
FIRST = 0.15
"""Which part of the samples begins an episode: there nothing but pictures and sentence
tell which arm goes, and where to."""
FOCUS = 0.4
"""Which part of the samples is of decisive moments."""
JUMP = 0.12
"""A waypoint that moves further [m], or turns a column of its rotation further, between
two frames is a new one: straight lines are led at no more than 0.1 m a frame."""
GRIPPER_JUMP_M = 0.05
ROBOTS = 2
AROUND = (-1, 1)
"""Frames beside those at which it begins that are decisive too."""
ARRIVED = 0.05
"""A tool is where it was sent if all numbers of its pose are this near [m, 1]."""
UNSEEN = 1e6
"""A policy that normalizes a number by this range does not see it."""
STATISTICS_OF = 5_000
"""So many pictures tell mean and deviation."""
DRAWS_ON = "MUJOCO_EGL_DEVICE_ID"
"""Environment variable that names a GPU to MuJoCo."""
READERS = 8
"""Threads that read a film."""

_HIDDEN = {"mean": 0.0, "std": UNSEEN, "min": -UNSEEN, "max": UNSEEN}

Batch = dict[str, Any]
"""Samples, as LeRobot's data sets have them."""


def film_shard(
    shard: Shard, style: Style, folder: Path, gpus: Sequence[str] = ()
) -> int:
    """Write some episodes as arrays; return how many frames they have.

    Args:
        shard: Which episodes.
        style: How they are filmed.
        folder: Where to.
        gpus: Numbers of those that processes draw on, each on one of them.
    """
    if gpus:
        # Read when this process draws for the first time.
        os.environ.setdefault(DRAWS_ON, gpus[os.getpid() % len(gpus)])
    target = folder / f"{shard.folder.name}.npz"
    if not target.exists():
        episodes = []
        for record in read_records(shard.path, shard.group, shard.rows):
            rows = list(frames(record, style))
            names = [n for n in rows[0] if n in VECTORS or n.startswith(OBS_IMAGES)]
            episodes.append({n: np.stack([row[n] for row in rows]) for n in names})
        columns = {
            name: np.concatenate([episode[name] for episode in episodes])
            for name in episodes[0]
        }
        columns[LENGTHS] = np.array([len(episode[ACTION]) for episode in episodes])
        draft = target.with_suffix(f".{os.getpid()}")
        with draft.open("wb") as file:
            np.savez(file, allow_pickle=False, **columns)
        draft.rename(target)
    with np.load(target) as found:
        return int(found[LENGTHS].sum())


def film(
    recipe: Path,
    folder: Path,
    style: Style,
    workers: int,
    split: str = "train",
    tasks: tuple[str, ...] = (),
) -> None:
    """Write the episodes of a split as arrays; those that are there are kept.

    Args:
        recipe: Folder of the demonstrations.
        folder: Where to.
        style: How they are filmed.
        workers: Processes, each on one of the GPUs if there are some.
        split: Of the recipe.
        tasks: Names; all of the recipe if none.

    Raises:
        DatasetError: They cannot be learned from, or not be done again here.
        SystemExit: The folder holds a film with other options.
    """
    folder.mkdir(parents=True, exist_ok=True)
    source = RenderConfig(recipe=recipe, out=folder, tasks=tasks, splits=(split,))
    shards = LeRobotConfig(source=source, style=style).shards()
    check_source(recipe, list(dict.fromkeys(one.path for one in shards)), style)
    made_of = {"recipe": sha256_of(recipe / MANIFEST), "split": split, "tasks": tasks}
    description = json.dumps({**asdict(style), **made_of})
    about = folder / ABOUT
    if about.exists() and about.read_text() != description:
        raise SystemExit(f"{folder} holds another film. Choose another folder.")
    about.write_text(description)
    gpus = [name for name in visible_gpus() if name.isdigit()]
    jobs = [(shard, style, folder, gpus) for shard in shards]
    begin, count = time.monotonic(), 0
    for done in ProcessPool(workers).run(film_shard, jobs):
        count += done
    print(f"{folder}: {count} frames, {time.monotonic() - begin:.0f} s.", flush=True)


@dataclass(frozen=True)
class Film:
    """All frames of the demonstrations, on one device."""

    vectors: dict[str, torch.Tensor]
    """(frames, numbers) float32."""
    images: dict[str, torch.Tensor]
    """(frames, height, width, 3) uint8."""
    last: torch.Tensor
    """Of each frame, the number of the last one of its episode."""

    @classmethod
    def load(cls, folder: Path, device: str) -> "Film":
        """Read what :func:`film` wrote."""
        files = sorted(folder.glob("*.npz"))
        lengths = []
        for file in files:
            with np.load(file) as found:
                lengths.append(found[LENGTHS])
        every = torch.from_numpy(np.concatenate(lengths))
        ends = np.cumsum([counts.sum() for counts in lengths]).tolist()
        columns: dict[str, torch.Tensor] = {}
        with np.load(files[0]) as found:
            for name in (n for n in found.files if n != LENGTHS):
                part = torch.from_numpy(found[name])
                shape, kind = (ends[-1], *part.shape[1:]), part.dtype
                columns[name] = torch.empty(shape, dtype=kind, device=device)

        def fill(file: Path, end: int) -> None:
            with np.load(file) as found:
                for name, rows in columns.items():
                    part = torch.from_numpy(found[name])
                    rows[end - len(part) : end] = part

        with ThreadPoolExecutor(READERS) as readers:
            list(readers.map(fill, files, ends))
        last = torch.repeat_interleave(every.cumsum(0) - 1, every).to(device)
        images = {n: it for n, it in columns.items() if n.startswith(OBS_IMAGES)}
        vectors = {n: columns[n] for n in VECTORS if n in columns}
        return cls(vectors, images, last)

    def features(self) -> tuple[dict[str, PolicyFeature], dict[str, PolicyFeature]]:
        """Return what a policy observes, and what it commands."""
        kinds = {OBS_STATE: FeatureType.STATE, OBS_ENV_STATE: FeatureType.ENV}
        seen = {
            name: PolicyFeature(kinds[name], (rows.shape[1],))
            for name, rows in self.vectors.items()
            if name != ACTION
        }
        for name, rows in self.images.items():
            _, height, width, channels = rows.shape
            shape = (channels, height, width)
            seen[name] = PolicyFeature(FeatureType.VISUAL, shape)
        row = PolicyFeature(FeatureType.ACTION, (self.vectors[ACTION].shape[1],))
        return seen, {ACTION: row}

    def statistics(self, *, poses: bool = True) -> dict[str, dict[str, torch.Tensor]]:
        """Return what values are normalized by, in the names of LeRobot.

        Args:
            poses: Whether a policy shall be told the poses of its own hands. Without
                them it is told how far they are open, and must look for the rest.
        """
        found = {}
        for name, rows in self.vectors.items():
            found[name] = _statistics(rows, 0)
        if not poses:
            state = found[OBS_STATE]
            hidden = torch.ones_like(state["mean"], dtype=torch.bool)
            hidden.reshape(ROBOTS, -1)[:, -1] = False
            for key, value in _HIDDEN.items():
                state[key][hidden] = value
        for name, rows in self.images.items():
            every = max(1, len(rows) // STATISTICS_OF)
            some = rows[::every].float() / 255.0
            image = _statistics(some, (0, 1, 2))
            found[name] = {key: value[:, None, None] for key, value in image.items()}
        return found

    def begins(self) -> torch.Tensor:
        """Return the first frame of each episode, (episodes,)."""
        return torch.cat([self.last.new_zeros(1), self.last.unique()[:-1] + 1])

    def new_waypoints(self) -> torch.Tensor:
        """Return at which frames a waypoint is new, (frames,)."""
        action = self.vectors[ACTION]
        new = torch.zeros(len(action), dtype=torch.bool, device=action.device)
        change = (action[1:] - action[:-1]).abs().reshape(len(action) - 1, ROBOTS, -1)
        new[1:] = (change[..., :-1] > JUMP).any(2).any(1)
        new[1:] |= (change[..., -1] > GRIPPER_JUMP_M).any(1)
        new[self.begins()] = True
        return new

    def decisive(self) -> torch.Tensor:
        """Return at which frames a new waypoint begins, or will soon, (frames,).

        While an arm moves, its own pose tells where it goes. A policy that learns to
        read it there knows nothing where the arm still stands, and believes itself
        afterwards. See Wen et al., "Keyframe-Focused Visual Imitation Learning", 2021.
        """
        found = self.new_waypoints()
        frames = found.nonzero().ravel()
        for steps in AROUND:
            beside = (frames + steps).clamp(0, len(found) - 1)
            # The neighbor of a frame may be a frame of another episode.
            found[beside[self.last[beside] == self.last[frames]]] = True
        return found

    def idle(self) -> torch.Tensor:
        """Return at which frames all is done and the arms are home again, (frames,).

        They stand as at the beginning: a policy that learns from both to look at its
        pose alone never begins.
        """
        here = torch.arange(len(self.last), device=self.last.device)
        new = here[self.new_waypoints()]
        newest = new.new_zeros(len(here))
        newest.scatter_reduce_(0, self.last[new], new, "amax")
        state, action = self.vectors[OBS_STATE], self.vectors[ACTION]
        there = ((action - state).abs() < ARRIVED).all(1)
        return there & (here > newest[self.last])

    def samples(self, index: torch.Tensor, config: Any) -> dict[str, Any]:
        """Return frames by number, as LeRobot's data sets have them.

        Args:
            index: Numbers of frames, (n,).
            config: Of the policy that is given them.
        """
        found: dict[str, Any] = {
            name: rows[index] for name, rows in self.vectors.items()
        }
        for name, rows in self.images.items():
            # Seen as (channels, height, width), in the order that is fast.
            found[name] = rows[index].permute(0, 3, 1, 2).float() / 255.0
        if config.observation_delta_indices is not None:
            found = {name: rows[:, None] for name, rows in found.items()}
        ahead = torch.tensor(config.action_delta_indices, device=index.device)
        wanted, end = index[:, None] + ahead, self.last[index][:, None]
        found[ACTION] = self.vectors[ACTION][wanted.minimum(end)]
        found[f"{ACTION}_is_pad"] = wanted > end
        return found

    def batches(self, config: Any, size: int, seed: int) -> Iterator[dict[str, Any]]:
        """Yield random samples for ever.

        :data:`FIRST` of them begin an episode, :data:`FOCUS` are at decisive frames.
        """
        device = self.last.device
        drawing = torch.Generator(device=device).manual_seed(seed)
        dropped = getattr(config, "drop_n_last_frames", 0)
        here = torch.arange(len(self.last), device=device)
        valid = here[(here <= self.last - dropped) & ~self.idle()]
        decisive = valid[self.decisive()[valid]]
        first, focused = round(FIRST * size), round(FOCUS * size)
        begins = self.begins()

        def draw(frames: torch.Tensor, count: int) -> torch.Tensor:
            many = len(frames)
            drawn = torch.randint(many, (count,), generator=drawing, device=device)
            return frames[drawn]

        while True:
            drawn = [draw(begins, first), draw(decisive, focused)]
            drawn.append(draw(valid, size - first - focused))
            yield self.samples(torch.cat(drawn), config)


def _statistics(rows: torch.Tensor, axes: Any) -> dict[str, torch.Tensor]:
    return {
        "mean": rows.mean(axes),
        "std": rows.std(axes),
        "min": rows.amin(axes),
        "max": rows.amax(axes),
    }
