"""Images of demonstrations as arrays, and training samples of them.

:func:`film` executes a recipe again and writes the data of ``lemma render --form
lerobot`` frame by frame, as arrays instead of videos. :class:`Film` holds all of them
on the device of the training, which saves reading, decoding and copying.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lemma.core.files import sha256_of
from lemma.core.workers.pool import ProcessPool
from lemma.dataset.files import MANIFEST
from lemma.dataset.lerobot.export import LeRobotConfig, Shard
from lemma.dataset.lerobot.frames import Style, frames, robots_of
from lemma.dataset.lerobot.sources import check_source, read_records
from lemma.dataset.lerobot.statistics import widened
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.render import RenderConfig
from lemma.dataset.rendered.steps import NO_SUBTASK, DenseStep
from side_by_side import visible_gpus

ABOUT, LENGTHS = "about.json", "lengths"
VECTORS = (OBS_STATE, OBS_ENV_STATE, ACTION)
FIRST = 0.15
"""Share of the samples at the start of an episode, where the arm and its target follow
from images and instruction alone."""
FOCUS = 0.4
"""Share of the samples at decisive frames; see :meth:`Film.decisive`."""
JUMP = 0.12
"""A waypoint is new if it moves by more than this [m] between two frames, or a column
of its rotation does. Straight motions have at most 0.1 m per frame."""
GRIPPER_JUMP_M = 0.05
ROBOTS = 2
AROUND = (-1, 1)
"""Frames around the first one of a new waypoint that are decisive, too."""
ARRIVED = 0.05
"""A tool is at its target if all numbers of its pose are this close [m, 1]."""
UNSEEN = 1e6
"""Normalization range that hides a number from a policy."""
STATISTICS_OF = 5_000
"""Number of images for mean and standard deviation."""
DISPLACEMENT_RAD = 0.1
"""Standard deviation by which a displaced arm's joints are turned [rad]."""
OPEN_M = 0.09
"""A gripper that is and stays this open holds nothing [m]."""
LOWEST_M = 0.05
"""Lowest height of a displaced tool over the table [m]."""
DRAWS_ON = "MUJOCO_EGL_DEVICE_ID"
"""Environment variable with the number of MuJoCo's GPU."""
READERS = 8
"""Number of threads that read a film."""

_HIDDEN = {"mean": 0.0, "std": UNSEEN, "min": -UNSEEN, "max": UNSEEN}

Batch = dict[str, Any]
"""Samples in the format of LeRobot's data sets."""


def film_shard(
    shard: Shard,
    style: Style,
    folder: Path,
    gpus: Sequence[str] = (),
    share: float = 0.0,
) -> int:
    """Write the episodes of a shard as arrays; return their number of frames.

    Args:
        shard: The episodes.
        style: Options of the rendering.
        folder: Folder of the output.
        gpus: Numbers of the GPUs for rendering; each process uses one.
        share: Share of frames with a displaced arm; see :func:`displaced`.
    """
    if gpus:
        # MuJoCo reads it at the first rendering of this process.
        os.environ.setdefault(DRAWS_ON, gpus[os.getpid() % len(gpus)])
    target = folder / f"{shard.folder.name}.npz"
    if not target.exists():
        episodes = []
        for record in read_records(shard.path, shard.group, shard.rows):
            change = displaced(record, share) if share else None
            rows = list(frames(record, style, change=change))
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


def displaced(record: EpisodeRecord, share: float) -> Callable[[DenseStep], DenseStep]:
    """Return a function that moves the busy arm away from its way in some frames.

    The waypoint leads back from beside the way, too. Without such frames a
    policy has seen arms only on their way, and drifts away once one has left it. Arms
    that may hold something stay. Nothing is simulated: a displaced arm may reach into
    things, except with its tool into the table. See Laskey et al., "DART: Noise
    Injection for Robust Imitation Learning", 2017.

    Args:
        record: The episode.
        share: Share of the frames, from 0 to 1.
    """
    rng = np.random.default_rng(int(record.instance_sha256[:16], 16))
    names = robots_of(record)

    def change(step: DenseStep) -> DenseStep:
        if step.subtask == NO_SUBTASK or rng.random() >= share:
            return step
        number = names.index(record.subtasks[step.subtask].robot)
        if min(step.opening_m[number], step.action[number, -1]) < OPEN_M:
            return step
        scene = step.scene
        robot = scene.robots[number]
        before = scene.data.qpos[robot.qpos].copy()
        scene.data.qpos[robot.qpos] += rng.normal(0.0, DISPLACEMENT_RAD, len(before))
        mujoco.mj_kinematics(scene.model, scene.data)
        site = int(scene.tcp_sites[number])
        if scene.data.site_xpos[site, 2] < LOWEST_M:
            scene.data.qpos[robot.qpos] = before
            mujoco.mj_kinematics(scene.model, scene.data)
            return step
        joints, poses = step.joints.copy(), step.tcp_poses.copy()
        joints[number] = scene.data.qpos[robot.qpos]
        poses[number, :3, :3] = scene.data.site_xmat[site].reshape(3, 3)
        poses[number, :3, 3] = scene.data.site_xpos[site]
        return replace(step, joints=joints, tcp_poses=poses)

    return change


def film(
    recipe: Path,
    folder: Path,
    style: Style,
    workers: int,
    split: str = "train",
    tasks: tuple[str, ...] = (),
    share: float = 0.0,
) -> None:
    """Write the episodes of a split as arrays; existing ones are kept.

    Args:
        recipe: Folder of the demonstrations.
        folder: Folder of the output.
        style: Options of the rendering.
        workers: Number of processes, each with one of the GPUs, if any.
        split: Split of the recipe.
        tasks: Names of tasks; all of the recipe if empty.
        share: Share of frames with a displaced arm; see :func:`displaced`.

    Raises:
        DatasetError: The recipe is no training data, or cannot be executed here.
        SystemExit: The folder has a film with other options.
    """
    folder.mkdir(parents=True, exist_ok=True)
    source = RenderConfig(recipe=recipe, out=folder, tasks=tasks, splits=(split,))
    shards = LeRobotConfig(source=source, style=style).shards()
    check_source(recipe, list(dict.fromkeys(one.path for one in shards)), style)
    made_of = {"recipe": sha256_of(recipe / MANIFEST), "split": split, "tasks": tasks}
    description = json.dumps({**asdict(style), **made_of, "displaced": share})
    about = folder / ABOUT
    if about.exists() and about.read_text() != description:
        raise SystemExit(f"{folder} holds another film. Choose another folder.")
    about.write_text(description)
    gpus = [name for name in visible_gpus() if name.isdigit()]
    jobs = [(shard, style, folder, gpus, share) for shard in shards]
    begin, count = time.monotonic(), 0
    for done in ProcessPool(workers).run(film_shard, jobs):
        count += done
    print(f"{folder}: {count} frames, {time.monotonic() - begin:.0f} s.", flush=True)


@dataclass(frozen=True)
class Film:
    """All frames of the demonstrations, on one device."""

    vectors: dict[str, torch.Tensor]
    """States and actions by name, (frames, numbers) float32."""
    images: dict[str, torch.Tensor]
    """Images by camera, (frames, height, width, 3) uint8."""
    last: torch.Tensor
    """For each frame, the index of the last frame of its episode, (frames,)."""

    @classmethod
    def load(cls, folder: Path, device: str) -> "Film":
        """Read the output of :func:`film`."""
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
        """Return the features of a policy's inputs and outputs."""
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
        """Return the statistics for normalization, with LeRobot's names.

        Args:
            poses: Whether the policy's state has the poses of its hands. Otherwise it
                has only their openings, and the poses must come from the images.
        """
        plain = {
            name: {key: value.tolist() for key, value in _statistics(rows, 0).items()}
            for name, rows in self.vectors.items()
        }
        found = {
            name: {key: torch.tensor(value) for key, value in feature.items()}
            for name, feature in widened(plain).items()
        }
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
        """Return whether each frame has a new waypoint, (frames,) bool."""
        action = self.vectors[ACTION]
        new = torch.zeros(len(action), dtype=torch.bool, device=action.device)
        change = (action[1:] - action[:-1]).abs().reshape(len(action) - 1, ROBOTS, -1)
        new[1:] = (change[..., :-1] > JUMP).any(2).any(1)
        new[1:] |= (change[..., -1] > GRIPPER_JUMP_M).any(1)
        new[self.begins()] = True
        return new

    def decisive(self) -> torch.Tensor:
        """Return whether a new waypoint begins at or near each frame, (frames,) bool.

        While an arm moves, its own pose reveals its target. A policy that learns this
        shortcut does not know the target while the arm stands still, and then follows
        its own wrong motion. See Wen et al., "Keyframe-Focused Visual Imitation
        Learning", 2021.
        """
        found = self.new_waypoints()
        frames = found.nonzero().ravel()
        for steps in AROUND:
            beside = (frames + steps).clamp(0, len(found) - 1)
            # Ignore neighbors in another episode.
            found[beside[self.last[beside] == self.last[frames]]] = True
        return found

    def idle(self) -> torch.Tensor:
        """Return whether the task is done and the arms are parked, (frames,) bool.

        The arms have the same pose as at the start. A policy that trains on both and
        uses the pose alone never begins to move.
        """
        here = torch.arange(len(self.last), device=self.last.device)
        new = here[self.new_waypoints()]
        newest = new.new_zeros(len(here))
        newest.scatter_reduce_(0, self.last[new], new, "amax")
        state, action = self.vectors[OBS_STATE], self.vectors[ACTION]
        there = ((action - state).abs() < ARRIVED).all(1)
        return there & (here > newest[self.last])

    def samples(self, index: torch.Tensor, config: Any) -> dict[str, Any]:
        """Return frames in the format of LeRobot's data sets.

        Args:
            index: Indices of frames, (n,).
            config: Configuration of the policy.
        """
        found: dict[str, Any] = {
            name: rows[index] for name, rows in self.vectors.items()
        }
        for name, rows in self.images.items():
            # A view as (channels, height, width); memory stays channels-last, for
            # speed.
            found[name] = rows[index].permute(0, 3, 1, 2).float() / 255.0
        if config.observation_delta_indices is not None:
            found = {name: rows[:, None] for name, rows in found.items()}
        ahead = torch.tensor(config.action_delta_indices, device=index.device)
        wanted, end = index[:, None] + ahead, self.last[index][:, None]
        found[ACTION] = self.vectors[ACTION][wanted.minimum(end)]
        found[f"{ACTION}_is_pad"] = wanted > end
        return found

    def batches(self, config: Any, size: int, seed: int) -> Iterator[dict[str, Any]]:
        """Yield random batches without end.

        The share :data:`FIRST` is at the start of an episode, :data:`FOCUS` at decisive
        frames.
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
