r"""Train ACT or Diffusion Policy of LeRobot on pictures in the memory of a GPU.

    python scripts/train_lerobot_policy.py film data/recipe /dev/shm/film
    python scripts/train_lerobot_policy.py train /dev/shm/film runs/act --policy act

``film`` executes a recipe again and writes what ``lemma render --form lerobot`` would,
frame by frame, as arrays instead of videos. ``train`` holds all of it on the device
that computes, so nothing waits for a disk, a decoder or a copy: the network, its loss
and its processors are LeRobot's, and so is the checkpoint. ``--train-s`` ends it after
a time instead of a number of steps, with a learning rate that falls to 0 by then.
"""

import argparse
import json
import math
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lemma.core.files import sha256_of, write_json
from lemma.core.workers.pool import ProcessPool
from lemma.dataset.files import MANIFEST
from lemma.dataset.lerobot.export import LeRobotConfig, Shard
from lemma.dataset.lerobot.frames import PRIVILEGED, SENTENCE, Style, frames
from lemma.dataset.lerobot.sources import check_source, read_records
from lemma.dataset.rendered.render import RenderConfig
from lemma.env.learning.motor_state import WAYPOINT

POLICIES: dict[str, dict[str, Any]] = {
    "act": {
        "chunk_size": 10,
        "n_action_steps": 3,
        "dim_model": 256,
        "dim_feedforward": 1024,
        "use_vae": False,
        "dropout": 0.0,
    },
    "diffusion": {
        "n_obs_steps": 1,
        "horizon": 8,
        "n_action_steps": 3,
        "drop_n_last_frames": 5,
        "crop_ratio": 1.0,
        "down_dims": (64, 128, 256),
        "use_group_norm": True,
        "use_separate_rgb_encoder_per_camera": False,
        "noise_scheduler_type": "DDIM",
        "num_inference_steps": 10,
    },
}
"""What is not LeRobot's default. Demonstrations are deterministic, so ACT needs no
latent variable."""
ABOUT, LENGTHS = "about.json", "lengths"
VECTORS = (OBS_STATE, OBS_ENV_STATE, ACTION)
WARMUP_STEPS = 500
LONGEST_GRADIENT = 10.0
FOCUS = 0.5
"""Which part of the samples is of decisive moments."""
JUMP = 0.12
"""A waypoint that moves further [m], or turns a column of its rotation further, between
two frames is a new one: straight lines are led at no more than 0.1 m a frame."""
GRIPPER_JUMP_M = 0.05
ROBOTS = 2
AROUND = (-1, 1)
"""Frames beside those at which it begins that are decisive too."""
STATISTICS_OF = 20_000
"""So many pictures tell mean and deviation."""


def film_shard(shard: Shard, style: Style, folder: Path) -> int:
    """Write some episodes as arrays; return how many frames they have."""
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
    recipe: Path, folder: Path, style: Style, workers: int, split: str = "train"
) -> None:
    """Write the episodes of a split as arrays; those that are there are kept.

    Raises:
        DatasetError: They cannot be learned from, or not be done again here.
        SystemExit: What is there was filmed otherwise.
    """
    folder.mkdir(parents=True, exist_ok=True)
    source = RenderConfig(recipe=recipe, out=folder, splits=(split,))
    shards = LeRobotConfig(source=source, style=style).shards()
    check_source(recipe, list(dict.fromkeys(one.path for one in shards)), style)
    told = json.dumps(
        {**asdict(style), "recipe": sha256_of(recipe / MANIFEST), "split": split}
    )
    about = folder / ABOUT
    if about.exists() and about.read_text() != told:
        raise SystemExit(f"{folder} holds another film. Choose another folder.")
    about.write_text(told)
    jobs = [(shard, style, folder) for shard in shards]
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
        total = int(np.concatenate(lengths).sum())
        columns: dict[str, torch.Tensor] = {}
        first = 0
        for file, counts in zip(files, lengths, strict=True):
            end = first + int(counts.sum())
            with np.load(file) as found:
                for name in (n for n in found.files if n != LENGTHS):
                    part = torch.from_numpy(found[name])
                    if name not in columns:
                        shape, kind = (total, *part.shape[1:]), part.dtype
                        columns[name] = torch.empty(shape, dtype=kind, device=device)
                    columns[name][first:end] = part
            first = end
        every = torch.from_numpy(np.concatenate(lengths))
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

    def statistics(self) -> dict[str, dict[str, torch.Tensor]]:
        """Return what values are normalized by, in the names of LeRobot."""
        found = {}
        for name, rows in self.vectors.items():
            found[name] = _statistics(rows, 0)
        for name, rows in self.images.items():
            every = max(1, len(rows) // STATISTICS_OF)
            some = rows[::every].float() / 255.0
            told = _statistics(some, (0, 1, 2))
            found[name] = {key: value[:, None, None] for key, value in told.items()}
        return found

    def begins(self) -> torch.Tensor:
        """Return the first frame of each episode, (episodes,)."""
        return torch.cat([self.last.new_zeros(1), self.last.unique()[:-1] + 1])

    def decisive(self) -> torch.Tensor:
        """Return at which frames a new waypoint begins, or will soon, (frames,).

        While an arm moves, its own pose tells where it goes. A policy that learns to
        read it there knows nothing where the arm still stands, and believes itself
        afterwards. See Wen et al., "Keyframe-Focused Visual Imitation Learning", 2021.
        """
        action = self.vectors[ACTION]
        jump = torch.zeros(len(action), dtype=torch.bool, device=action.device)
        change = (action[1:] - action[:-1]).abs().reshape(len(action) - 1, ROBOTS, -1)
        jump[1:] = (change[..., :-1] > JUMP).any(2).any(1)
        jump[1:] |= (change[..., -1] > GRIPPER_JUMP_M).any(1)
        jump[self.begins()] = True
        found = jump.clone()
        for steps in AROUND:
            found |= jump.roll(steps)
        return found

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
        """Yield random samples for ever; :data:`FOCUS` of them at decisive frames."""
        device = self.last.device
        drawing = torch.Generator(device=device).manual_seed(seed)
        dropped = getattr(config, "drop_n_last_frames", 0)
        here = torch.arange(len(self.last), device=device)
        valid = here[here <= self.last - dropped]
        decisive = valid[self.decisive()[valid]]
        focused = round(FOCUS * size)

        def draw(frames: torch.Tensor, count: int) -> torch.Tensor:
            many = len(frames)
            drawn = torch.randint(many, (count,), generator=drawing, device=device)
            return frames[drawn]

        while True:
            index = torch.cat([draw(decisive, focused), draw(valid, size - focused)])
            yield self.samples(index, config)


def _statistics(rows: torch.Tensor, axes: Any) -> dict[str, torch.Tensor]:
    return {
        "mean": rows.mean(axes),
        "std": rows.std(axes),
        "min": rows.amin(axes),
        "max": rows.amax(axes),
    }


def make_policy(name: str, seen: Film, device: str) -> tuple[Any, Any, Any]:
    """Return a policy that knows nothing yet, and what comes before and after it."""
    inputs, outputs = seen.features()
    config = PreTrainedConfig.get_choice_class(name)(
        input_features=inputs,
        output_features=outputs,
        device=device,
        push_to_hub=False,
        pretrained_backbone_weights=None,
        **POLICIES[name],
    )
    if name == "act":
        # LeRobot's ACT has the normalization of its ResNet frozen, as it comes with
        # weights of ImageNet; without these it would be none at all. What is learned
        # here is saved under the same names, and frozen from then on.
        act = import_module("lerobot.policies.act.modeling_act")
        vars(act)["FrozenBatchNorm2d"] = torch.nn.BatchNorm2d
    policy = get_policy_class(name)(config).to(device)
    if device != "cpu":
        policy = policy.to(memory_format=torch.channels_last)
    before, after = make_pre_post_processors(config, dataset_stats=seen.statistics())
    return policy, before, after


def save(
    folder: Path, made: tuple[Any, Any, Any], asked: argparse.Namespace, step: int
) -> None:
    """Write a checkpoint as lerobot-train does, but what going on with it takes."""
    here = folder / "checkpoints" / f"{step:06d}"
    for part in made:
        part.save_pretrained(here / "pretrained_model")
    about = {
        "dataset": {"repo_id": "lemma/control"},
        "seed": asked.seed,
        "batch_size": asked.batch,
        "steps": asked.steps or step,
    }
    write_json(here / "pretrained_model" / "train_config.json", about)
    (here / "training_state").mkdir()
    write_json(here / "training_state" / "training_step.json", {"step": step})
    last = folder / "checkpoints" / "last"
    last.unlink(missing_ok=True)
    last.symlink_to(here.name)


def train(asked: argparse.Namespace) -> None:
    """Train a policy."""
    torch.manual_seed(asked.seed)
    torch.backends.cudnn.benchmark = True
    torch.set_float32_matmul_precision("high")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    seen = Film.load(asked.film, device)
    made = policy, before, _ = make_policy(asked.policy, seen, device)
    optimizer = torch.optim.AdamW(
        policy.parameters(), lr=asked.lr, weight_decay=1e-4, fused=device == "cuda"
    )
    batches = seen.batches(policy.config, asked.batch, asked.seed)
    print(f"{len(seen.last)} frames, {sum(p.numel() for p in policy.parameters())}")
    policy.train()
    begin = told = time.monotonic()
    step, saved, total = 0, 0, torch.zeros((), device=device)
    done = 0.0
    while done < 1.0:
        rate = asked.lr * min(1.0, (step + 1) / WARMUP_STEPS)
        for group in optimizer.param_groups:
            group["lr"] = rate * 0.5 * (1.0 + math.cos(math.pi * done))
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            loss, _ = policy.forward(before(next(batches)))
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), LONGEST_GRADIENT)
        optimizer.step()
        step, total = step + 1, total + loss.detach()
        now = time.monotonic()
        done = step / asked.steps if asked.steps else (now - begin) / asked.train_s
        if step % asked.tell == 0:
            print(
                f"step {step}, {now - begin:.0f} s, {step * asked.batch} samples, "
                f"{asked.tell * asked.batch / (now - told):.0f} a second, "
                f"loss {total.item() / asked.tell:.4f}",
                flush=True,
            )
            told, total = now, torch.zeros((), device=device)
        if done >= (saved + 1) / asked.points:
            saved += 1
            save(asked.out, made, asked, step)


def main(words: Sequence[str] | None = None) -> None:
    """Do what the arguments say, on the command line by default."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    filming = verbs.add_parser("film")
    filming.add_argument("recipe", type=Path)
    filming.add_argument("film", type=Path)
    filming.add_argument("--size", default="160x120")
    filming.add_argument("--fps", type=int, default=5)
    filming.add_argument(
        "--environment-state", choices=(SENTENCE, PRIVILEGED), default=SENTENCE
    )
    filming.add_argument("--split", default="train")
    filming.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    training = verbs.add_parser("train")
    training.add_argument("film", type=Path)
    training.add_argument("out", type=Path)
    training.add_argument("--policy", choices=POLICIES, required=True)
    training.add_argument("--seed", type=int, default=0)
    training.add_argument("--batch", type=int, default=128)
    training.add_argument("--lr", type=float, default=5e-4)
    training.add_argument("--steps", type=int, default=0)
    training.add_argument("--train-s", type=float, default=600.0)
    training.add_argument("--points", type=int, default=4, help="checkpoints")
    training.add_argument("--tell", type=int, default=100, help="steps between words")
    asked = parser.parse_args(words)
    if asked.verb == "film":
        width, height = map(int, asked.size.split("x"))
        style = Style(
            fps=asked.fps,
            width_px=width,
            height_px=height,
            depth=False,
            images=asked.environment_state == SENTENCE,
            environment_state=asked.environment_state,
            control=WAYPOINT,
        )
        film(asked.recipe, asked.film, style, asked.workers, asked.split)
    else:
        train(asked)


if __name__ == "__main__":
    main()
