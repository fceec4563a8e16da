r"""Train LeRobot's ACT or Diffusion Policy on images in the memory of a GPU.

    python scripts/train_lerobot_policy.py film data/recipe /dev/shm/film
    python scripts/train_lerobot_policy.py train /dev/shm/film runs/act --policy act

``film`` executes a recipe again and writes the data of ``lemma render --form lerobot``
frame by frame, as arrays instead of videos. ``train`` holds all of them on the device
of the training, which saves reading, decoding and copying. The network, its loss, its
processors and the format of the checkpoint are LeRobot's. ``--train-s`` ends the
training after a time instead of a number of steps; the learning rate decays to 0 at
that time.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import OBS_IMAGES

from demonstration_film import Batch, Film, film
from lemma.core.files import write_json
from lemma.dataset.lerobot.frames import PRIVILEGED, SENTENCE, Style
from lemma.env.learning.motor_state import WAYPOINT
from lemma.policies.weights_file import TIME_LIMIT

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
        "drop_n_last_frames": 0,
        "crop_ratio": 1.0,
        "down_dims": (64, 128, 256),
        "use_group_norm": True,
        "use_separate_rgb_encoder_per_camera": False,
        "prediction_type": "sample",
        "noise_scheduler_type": "DDIM",
        "num_inference_steps": 10,
    },
}
"""Changes to LeRobot's defaults. Demonstrations are deterministic, so ACT needs no
latent variable. Diffusion Policy predicts actions instead of noise, which it learns
from fewer samples. Chunks may pass the end of an episode: its last waypoint stays the
target."""
NETWORKS = {
    "act": ("model.encoder", "model.decoder"),
    "diffusion": ("diffusion.rgb_encoder", "diffusion.unet"),
}
"""Networks that are compiled, besides ACT's ResNet. Without images some are missing."""
WARMUP_STEPS = 500
LONGEST_GRADIENT = 10.0
STEPS_BEFORE_CAPTURE = 3
"""Steps for libraries to choose their kernels, and for the optimizer's state."""

FULL, GRIPPERS = STATES = ("full", "grippers")
"""State of the arms in a policy's input: with the poses of the hands, or only their
openings."""
NO_END = 10**9
"""Number of steps in the options of a training with a time limit; weights record it."""

Learn = Callable[[Batch], torch.Tensor]
"""Runs a training step, and returns its loss."""


def options(name: str, chunk: int = 0, executed: int = 0) -> dict[str, Any]:
    """Return the changes to LeRobot's defaults.

    Args:
        name: One of :data:`POLICIES`.
        chunk: Number of predicted actions; 0 for that of :data:`POLICIES`.
        executed: Number of actions that are executed of them, likewise.
    """
    found = dict(POLICIES[name])
    predicted = "chunk_size" if name == "act" else "horizon"
    found[predicted] = chunk or found[predicted]
    found["n_action_steps"] = executed or found["n_action_steps"]
    return found


def make_policy(
    name: str,
    seen: Film,
    device: str,
    state: str = FULL,
    *,
    compiled: bool = False,
    **lengths: int,
) -> tuple[Any, Any, Any]:
    """Return an untrained policy with its pre- and post-processors.

    Args:
        name: One of :data:`POLICIES`.
        seen: Its training data.
        device: Device of the policy.
        state: One of :data:`STATES`.
        compiled: Whether to compile its networks, which takes a minute.
        lengths: As in :func:`options`.
    """
    inputs, outputs = seen.features()
    config = PreTrainedConfig.get_choice_class(name)(
        input_features=inputs,
        output_features=outputs,
        device=device,
        push_to_hub=False,
        pretrained_backbone_weights=None,
        **options(name, **lengths),
    )
    if name == "act":
        # LeRobot's ACT has frozen batch normalization in its ResNet, for weights of
        # ImageNet. Without these it would not normalize. Here it is trained and saved
        # under the same names; at inference it is frozen.
        act = import_module("lerobot.policies.act.modeling_act")
        vars(act)["FrozenBatchNorm2d"] = torch.nn.BatchNorm2d
    policy = get_policy_class(name)(config).to(device)
    if name == "act" and config.image_features:
        normalize_together(policy.model, compiled=compiled)
    if compiled:
        for part, network in policy.named_modules():
            if part in NETWORKS[name]:
                network.compile()
    if device != "cpu":
        policy = policy.to(memory_format=torch.channels_last)
    statistics = seen.statistics(poses=state == FULL)
    before, after = make_pre_post_processors(config, dataset_stats=statistics)
    return policy, before, after


def normalize_together(act: Any, *, compiled: bool = False) -> None:
    """Make batch normalization see the images of all cameras of ACT as one batch.

    LeRobot's ACT runs its ResNet camera by camera. In training each camera would be
    normalized by its own statistics, but there is only one average of them for
    inference: waypoints were 9 cm off after training, and 1 cm during it.

    Args:
        act: The network of the policy.
        compiled: Whether to compile its ResNet.
    """
    alone = act.backbone.forward
    if compiled:
        alone = torch.compile(alone)
    seen: list[torch.Tensor] = []

    def look(_: Any, inputs: tuple[Batch]) -> None:
        images = inputs[0][OBS_IMAGES]
        seen[:] = alone(torch.cat(images))["feature_map"].chunk(len(images))

    act.register_forward_pre_hook(look)
    act.backbone.forward = lambda _: {"feature_map": seen.pop(0)}


def save(
    folder: Path,
    made: tuple[Any, Any, Any],
    asked: argparse.Namespace,
    step: int,
    share: float,
) -> None:
    """Write a checkpoint in lerobot-train's format, without the state to resume.

    Args:
        folder: Folder of the training.
        made: The policy with its pre- and post-processors.
        asked: Options of the training.
        step: Number of steps so far.
        share: Completed share of the training; 1 at its end.
    """
    here = folder / "checkpoints" / f"{step:06d}"
    for part in made:
        part.save_pretrained(here / "pretrained_model")
    about = {
        "dataset": {"repo_id": "lemma/control"},
        "seed": asked.seed,
        "batch_size": asked.batch,
        "steps": asked.steps or NO_END,
        **({} if asked.steps else {"ended": TIME_LIMIT}),
    }
    write_json(here / "pretrained_model" / "train_config.json", about)
    (here / "training_state").mkdir()
    state = {"step": step, "share": share}
    write_json(here / "training_state" / "training_step.json", state)
    last = folder / "checkpoints" / "last"
    last.unlink(missing_ok=True)
    last.symlink_to(here.name)


def write_report(asked: argparse.Namespace, step: int, seconds: float) -> None:
    """Write the report of a finished training, which ``scripts/trainings.py`` reads.

    Args:
        asked: Options of the training.
        step: Number of its steps.
        seconds: Duration of the training, without its preparation [s].
    """
    gpu = torch.cuda.is_available()
    samples = step * asked.batch
    report = {
        "model": asked.policy,
        "samples": samples,
        "steps": step,
        "seconds": seconds,
        "samples_per_s": samples / seconds,
        "gpu_memory_gb": torch.cuda.max_memory_allocated() / 1e9 if gpu else 0.0,
        "device": torch.cuda.get_device_name() if gpu else "CPU",
        "status": "finished" if asked.steps else "time is up",
        "history": [],
        "command": " ".join(["python", *sys.argv]),
    }
    write_json(asked.out / "report.json", report)


def make_step(policy: Any, rate: torch.Tensor) -> Learn:
    """Return a function that runs a training step.

    Args:
        policy: Policy of LeRobot, whose weights are updated.
        rate: Learning rate, (); the caller sets it before each step.
    """
    device = rate.device.type
    gpu = device == "cuda"
    optimizer = torch.optim.AdamW(
        policy.parameters(), lr=rate, weight_decay=1e-4, fused=gpu, capturable=gpu
    )

    def learn(batch: Batch) -> torch.Tensor:
        # By default ACT creates its zeros on the CPU.
        with torch.autocast(device, torch.bfloat16, enabled=gpu), torch.device(device):
            loss, _ = policy.forward(batch)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), LONGEST_GRADIENT)
        optimizer.step()
        found: torch.Tensor = loss.detach()
        return found

    return learn


def captured(learn: Learn, batch: Batch) -> Learn:
    """Return the same step as one CUDA graph, after some steps with this batch.

    Launching these kernels one by one takes longer than their execution.
    """
    held = {name: rows for name, rows in batch.items() if torch.is_tensor(rows)}
    beside = torch.cuda.Stream()
    beside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(beside):
        for _ in range(STEPS_BEFORE_CAPTURE):
            learn(held)
    torch.cuda.current_stream().wait_stream(beside)
    graph = torch.cuda.CUDAGraph()
    # ACT reads its loss for logging, which a graph does not allow.
    unread = patch.object(torch.Tensor, "item", lambda value: math.nan)
    with torch.cuda.graph(graph), unread:
        loss = learn(held)

    def replay(batch: Batch) -> torch.Tensor:
        for name, rows in held.items():
            rows.copy_(batch[name])
        graph.replay()
        return loss

    return replay


def train(asked: argparse.Namespace) -> None:
    """Train a policy."""
    torch.manual_seed(asked.seed)
    torch.backends.cudnn.benchmark = True
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.set_float32_matmul_precision("high")
    seen = Film.load(asked.film, device)
    lengths = {"chunk": asked.chunk, "executed": asked.executed}
    compiled = device == "cuda" and not asked.no_compile
    made = make_policy(
        asked.policy, seen, device, asked.state, compiled=compiled, **lengths
    )
    policy, before, _ = made
    batches = seen.batches(policy.config, asked.batch, asked.seed)
    print(f"{len(seen.last)} frames, {sum(p.numel() for p in policy.parameters())}")
    policy.train()
    rate = torch.tensor(asked.lr / WARMUP_STEPS, device=device)
    learn = make_step(policy, rate)
    if device == "cuda" and not asked.no_graph:
        learn = captured(learn, before(next(batches)))
    begin = reported = now = time.monotonic()
    step, saved, total = 0, 0, torch.zeros((), device=device)
    done = 0.0
    while done < 1.0:
        risen = min(1.0, (step + 1) / WARMUP_STEPS)
        rate.fill_(asked.lr * risen * 0.5 * (1.0 + math.cos(math.pi * done)))
        loss = learn(before(next(batches)))
        step, total = step + 1, total + loss
        now = time.monotonic()
        done = step / asked.steps if asked.steps else (now - begin) / asked.train_s
        if step % asked.tell == 0:
            print(
                f"step {step}, {now - begin:.0f} s, {step * asked.batch} samples, "
                f"{asked.tell * asked.batch / (now - reported):.0f} a second, "
                f"loss {total.item() / asked.tell:.4f}",
                flush=True,
            )
            reported, total = now, torch.zeros((), device=device)
        if (reached := min(int(done * asked.points), asked.points)) > saved:
            saved = reached
            save(asked.out, made, asked, step, min(done, 1.0))
    write_report(asked, step, now - begin)


def main(words: Sequence[str] | None = None) -> None:
    """Run the given arguments, by default those of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    filming = verbs.add_parser("film")
    filming.add_argument("recipe", type=Path)
    filming.add_argument("film", type=Path)
    filming.add_argument("--size", default="160x120")
    filming.add_argument("--fps", type=int, default=5)
    filming.add_argument(
        "--cameras", default="robot_0,robot_1", help="robot_0_reach,table,..."
    )
    filming.add_argument(
        "--environment-state", choices=(SENTENCE, PRIVILEGED), default=SENTENCE
    )
    filming.add_argument("--split", default="train")
    filming.add_argument(
        "--displaced",
        type=float,
        default=0.0,
        help="share of the frames in which the busy arm is moved off its way",
    )
    filming.add_argument("--tasks", default="", help="the recipe's if none")
    filming.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    training = verbs.add_parser("train")
    training.add_argument("film", type=Path)
    training.add_argument("out", type=Path)
    training.add_argument("--policy", choices=POLICIES, required=True)
    training.add_argument("--seed", type=int, default=0)
    training.add_argument(
        "--state", choices=STATES, default=FULL, help="what is told of the arms"
    )
    training.add_argument("--batch", type=int, default=128)
    training.add_argument("--chunk", type=int, default=0, help="predicted actions")
    training.add_argument("--executed", type=int, default=0, help="actions of a chunk")
    training.add_argument("--lr", type=float, default=5e-4)
    training.add_argument("--steps", type=int, default=0)
    training.add_argument("--train-s", type=float, default=600.0)
    training.add_argument("--points", type=int, default=4, help="checkpoints")
    training.add_argument("--tell", type=int, default=100, help="steps between words")
    training.add_argument(
        "--no-graph", action="store_true", help="launch kernels one by one"
    )
    training.add_argument(
        "--no-compile", action="store_true", help="use PyTorch's kernels as they are"
    )
    asked = parser.parse_args(words)
    if asked.verb == "film":
        if not 0.0 <= asked.displaced <= 1.0:
            parser.error("--displaced is a share, from 0 to 1.")
        width, height = map(int, asked.size.split("x"))
        images = asked.environment_state == SENTENCE
        style = Style(
            fps=asked.fps,
            width_px=width,
            height_px=height,
            cameras=tuple(asked.cameras.split(",")) if images else (),
            depth=False,
            images=images,
            environment_state=asked.environment_state,
            control=WAYPOINT,
        )
        tasks = tuple(filter(None, asked.tasks.split(",")))
        more = (asked.split, tasks, asked.displaced)
        film(asked.recipe, asked.film, style, asked.workers, *more)
    else:
        train(asked)


if __name__ == "__main__":
    main()
