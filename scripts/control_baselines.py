"""Train policies of LeRobot on motor commands, and evaluate them: control level.

In an environment with lerobot, such as the one that ``make test-lerobot`` makes, and
with what Diffusion Policy needs (``pip install 'lerobot[diffusion]'``):

    python scripts/control_baselines.py --out runs/control --print
    python scripts/control_baselines.py --out runs/control --seeds 0,1,2

It runs the commands that it prints: demonstrations, their videos, one training for each
policy and seed, all at the same time, each GPU in turn; then each checkpoint on split
val, which is the learning curve, and the last one on split test. What is there already
is kept, so the same command goes on where it was stopped.

One policy learns all tasks. It is told the sentence as numbers, because neither ACT nor
Diffusion Policy of LeRobot reads text.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch

from lemma.core.files import read_json, write_json
from lemma.evaluation.records import SUMMARY

TASKS = "pass,stack,poke,hook"
POLICIES = {
    "act": (
        "--policy.type=act --policy.pretrained_backbone_weights=null "
        "--policy.chunk_size=20 --policy.n_action_steps=10 --policy.dim_model=256 "
        "--policy.dim_feedforward=1024 --policy.optimizer_lr=1e-4 "
        "--policy.optimizer_lr_backbone=1e-4"
    ),
    "diffusion": (
        "--policy.type=diffusion --policy.pretrained_backbone_weights=null "
        "--policy.horizon=16 --policy.n_action_steps=8 "
        "--policy.crop_ratio=1.0 --policy.down_dims=[128,256,512] "
        "--policy.noise_scheduler_type=DDIM --policy.num_inference_steps=10"
    ),
}
"""Name and arguments of ``lerobot-train``; the rest is LeRobot's default."""
CURVE = "curve.json"


@dataclass(frozen=True)
class Plan:
    """What is wanted."""

    out: Path
    tasks: str
    size: str
    fps: int
    steps: int
    batch: int
    points: int
    """Checkpoints of the learning curve."""
    workers: int
    episodes: int
    """Of each task and split train."""
    tests: int
    """Of each task and split test."""
    device: str

    @property
    def recipe(self) -> Path:
        """Folder of the demonstrations."""
        return self.out / "recipe"

    @property
    def videos(self) -> Path:
        """Folder of what cameras saw."""
        return self.out / "videos"

    def run(self, name: str, seed: int) -> Path:
        """Return the folder of a training."""
        return self.out / f"{name}-{seed}"

    def data_commands(self) -> list[str]:
        """Return what makes the training data."""
        episodes = f" --episodes {self.episodes}" if self.episodes else ""
        return [
            f"lemma generate --tasks {self.tasks} --split train{episodes} "
            f"--out {self.recipe} --workers {self.workers}",
            f"lemma render {self.recipe} --form lerobot --size {self.size} --no-depth "
            f"--fps {self.fps} --sentence-vector --out {self.videos} "
            f"--workers {self.workers}",
        ]

    def training(self, name: str, seed: int, loaders: int) -> str:
        """Return the command of a training."""
        return (
            f"lerobot-train --dataset.repo_id=lemma/control "
            f"--dataset.root={self.videos} {POLICIES[name]} "
            f"--policy.device={self.device} --policy.push_to_hub=false --seed={seed} "
            f"--steps={self.steps} --batch_size={self.batch} --num_workers={loaders} "
            f"--save_freq={max(1, self.steps // self.points)} --log_freq=100 "
            f"--output_dir={self.run(name, seed)}"
        )

    def evaluation(self, checkpoint: Path, split: str, episodes: int, out: Path) -> str:
        """Return the command that evaluates a checkpoint."""
        some = f" --episodes {episodes}" if episodes else ""
        return (
            f"lemma evaluate --policy lerobot:{checkpoint} --tasks {self.tasks} "
            f"--policy-args hz={self.fps},device={self.device} --split {split}{some} "
            f"--workers {self.workers} --out {out}"
        )


def checkpoints(run: Path) -> list[tuple[int, Path]]:
    """Return what a training has saved, by number of steps."""
    found = sorted((run / "checkpoints").glob("[0-9]*/pretrained_model"))
    return [(int(each.parent.name), each) for each in found]


def do(command: str, log: Path, gpu: int | None = None) -> "subprocess.Popen[bytes]":
    """Start a command of this environment; what it says goes into a file."""
    log.parent.mkdir(parents=True, exist_ok=True)
    program, *words = command.split()
    environment = {**os.environ, "TOKENIZERS_PARALLELISM": "false"}
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = str(gpu)
    with log.open("ab") as told:
        return subprocess.Popen(
            [str(Path(sys.executable).with_name(program)), *words],
            stdout=told,
            stderr=subprocess.STDOUT,
            env=environment,
        )


def finish(command: str, log: Path) -> None:
    """Run a command to its end.

    Raises:
        SystemExit: It failed.
    """
    print(command, flush=True)
    if do(command, log).wait() != 0:
        raise SystemExit(f"This failed; see {log}: {command}")


def train(plan: Plan, runs: list[tuple[str, int]], until: float) -> None:
    """Train what is missing, all at once, until it is done or the time is over."""
    missing = [run for run in runs if not checkpoints(plan.run(*run))]
    gpus = torch.cuda.device_count()
    loaders = max(1, plan.workers // max(1, len(missing)))
    going = []
    for number, (name, seed) in enumerate(missing):
        command = plan.training(name, seed, loaders)
        print(command, flush=True)
        log = plan.out / f"{name}-{seed}.log"
        going.append((do(command, log, number % gpus if gpus else None), log))
    for process, log in going:
        try:
            code = process.wait(max(1.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            print(f"The time is over; see {log}.", flush=True)
            continue
        if code != 0:
            raise SystemExit(f"A training failed; see {log}.")


def curve(
    plan: Plan, run: tuple[str, int], episodes: int
) -> Iterator[dict[str, float]]:
    """Yield steps and success [%] on split val of each checkpoint of a training."""
    for steps, checkpoint in checkpoints(plan.run(*run)):
        out = plan.run(*run) / "val" / f"{steps}"
        command = plan.evaluation(checkpoint, "val", episodes, out)
        finish(command, plan.out / "evaluations.log")
        cells = read_json(out / SUMMARY)["cells"]
        played = sum(cell["episodes"] for cell in cells)
        solved = sum(cell["successes"] for cell in cells)
        yield {"steps": steps, "success": round(100.0 * solved / played, 1)}


def main() -> None:
    """Do what the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/control"))
    parser.add_argument("--tasks", default=TASKS)
    parser.add_argument("--policies", default=",".join(POLICIES))
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--fps", type=int, default=10)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--points", type=int, default=5)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--episodes", type=int, default=0, help="of each task; 0: all")
    parser.add_argument("--val", type=int, default=10, help="episodes of each task")
    parser.add_argument("--test", type=int, default=0, help="of each task; 0: all")
    parser.add_argument("--train-s", type=float, default=float("inf"))
    parser.add_argument("--print", action="store_true", help="do nothing")
    args = parser.parse_args()
    plan = Plan(
        args.out,
        *(args.tasks, args.size, args.fps, args.steps, args.batch, args.points),
        *(args.workers, args.episodes, args.test),
        "cuda" if torch.cuda.is_available() else "cpu",
    )
    seeds = [int(seed) for seed in args.seeds.split(",")]
    runs = [(name, seed) for seed in seeds for name in args.policies.split(",")]
    if args.print:
        for command in (
            *plan.data_commands(),
            *(plan.training(*run, plan.workers) for run in runs),
            *(
                plan.evaluation(
                    plan.run(*run) / "checkpoints/last/pretrained_model",
                    "test",
                    args.test,
                    plan.run(*run) / "test",
                )
                for run in runs
            ),
        ):
            print(command)
        return
    for command in plan.data_commands():
        finish(command, plan.out / "data.log")
    train(plan, runs, time.monotonic() + args.train_s)
    for run in runs:
        _, last = checkpoints(plan.run(*run))[-1]
        out = plan.run(*run) / "test"
        finish(
            plan.evaluation(last, "test", args.test, out), plan.out / "evaluations.log"
        )
    for run in runs:
        points = list(curve(plan, run, args.val))
        write_json(plan.run(*run) / CURVE, {"val": points})
        print(*run, points, flush=True)


if __name__ == "__main__":
    main()
