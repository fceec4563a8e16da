"""Train policies of LeRobot on motor commands, and evaluate them: control level.

In an environment with lerobot, such as the one that ``make test-lerobot`` makes:

    python scripts/control_baselines.py --print
    python scripts/control_baselines.py --seeds 0,1,2
    python scripts/control_baselines.py --observation privileged

It runs the commands that it prints: demonstrations, what cameras see of them, as arrays
in memory; one training for each policy and seed, all at the same time, each GPU in
turn; then the last checkpoint of each on split test, and some on split val, which is
the learning curve. What is there already is kept: the same command goes on where it was
stopped, but a training that was not done begins again. ``--phases`` does a part of it.

One policy learns all tasks. It is told the sentence as numbers, because neither ACT nor
Diffusion Policy of LeRobot reads text. With ``--observation privileged`` it is told the
truth instead, poses and goal, and sees nothing: an oracle.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

import torch

from lemma.core.files import read_json
from lemma.evaluation.experiments.catalog import CONTROL_TASKS
from lemma.evaluation.records import SUMMARY
from lemma.evaluation.report.learning_curves import CURVE, LearningCurve, Point
from lemma.policies.class_path import LEROBOT, LEROBOT_PRIVILEGED

POLICIES = ("act", "diffusion")
OBSERVATIONS = ("rgb", "privileged")
PHASES = ("data", "train", "test", "curve")
TRAINER = "scripts/train_lerobot_policy.py"
WEIGHTS = "pretrained_model"
"""Of a checkpoint: its folder for policies."""
STATE = "training_state/training_step.json"
"""Of a checkpoint: how far the training has come."""
LOOK_S = 0.5

Run = tuple[str, int]
"""A policy and a seed."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is wanted."""

    out: Path
    film: Path
    """Folder of what is seen in the demonstrations."""
    tasks: str
    observation: str
    size: str
    fps: int
    steps: int
    train_s: float
    """How long to train instead of a number of steps; 0 if these count."""
    batch: int
    points: int
    """Of the learning curve: checkpoints."""
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

    def run(self, name: str, seed: int) -> Path:
        """Return the folder of a training."""
        return self.out / f"{name}-{seed}"

    def data_commands(self) -> list[str]:
        """Return what makes the training data."""
        episodes = f" --episodes {self.episodes}" if self.episodes else ""
        told = "sentence" if self.observation == OBSERVATIONS[0] else self.observation
        return [
            f"lemma generate --tasks {self.tasks} --split train{episodes} "
            f"--out {self.recipe} --workers {self.workers}",
            f"python {TRAINER} film {self.recipe} {self.film} --size {self.size} "
            f"--fps {self.fps} --environment-state {told} --workers {self.workers}",
        ]

    def training(self, name: str, seed: int) -> str:
        """Return the command of a training."""
        long = f"--steps {self.steps}"
        if self.train_s:
            long = f"--train-s {self.train_s:g}"
        return (
            f"python {TRAINER} train {self.film} {self.run(name, seed)} "
            f"--policy {name} --seed {seed} {long} "
            f"--batch {self.batch} --points {self.points}"
        )

    def evaluation(self, checkpoint: Path, split: str, episodes: int, out: Path) -> str:
        """Return the command that evaluates a checkpoint."""
        some = f" --episodes {episodes}" if episodes else ""
        kind = LEROBOT if self.observation == OBSERVATIONS[0] else LEROBOT_PRIVILEGED
        return (
            f"lemma evaluate --policy {kind}{checkpoint} --tasks {self.tasks} "
            f"--policy-args hz={self.fps},device={self.device} --split {split}{some} "
            f"--workers {self.workers} --out {out}"
        )

    def trained(self, run: Run) -> bool:
        """Return whether a training has come to its end."""
        saved = checkpoints(self.run(*run))
        if not saved:
            return False
        _, last = saved[-1]
        state: dict[str, float] = read_json(last.parent / STATE)
        return state["share"] >= 1.0

    def test(self, run: Run, checkpoint: Path) -> str:
        """Return the command that evaluates a checkpoint on split test."""
        return self.evaluation(checkpoint, "test", self.tests, self.run(*run) / "test")

    def commands(self, runs: Sequence[Run]) -> list[str]:
        """Return all commands, but those of the learning curve."""
        last = f"checkpoints/last/{WEIGHTS}"
        return [
            *self.data_commands(),
            *(self.training(*run) for run in runs),
            *(self.test(run, self.run(*run) / last) for run in runs),
        ]


def checkpoints(run: Path) -> list[tuple[int, Path]]:
    """Return what a training has saved, whole, by number of steps."""
    # The number of the step is written last.
    whole = sorted((run / "checkpoints").glob(f"[0-9]*/{STATE}"))
    return [(int(each.parts[-3]), each.parents[1] / WEIGHTS) for each in whole]


def do(command: str, log: Path, gpu: int | None = None) -> "subprocess.Popen[bytes]":
    """Start a command of this environment; what it says goes into a file."""
    print(f"{time.strftime('%X')} {command}", flush=True)
    log.parent.mkdir(parents=True, exist_ok=True)
    program, *words = command.split()
    environment = {**os.environ, "TOKENIZERS_PARALLELISM": "false"}
    if "=" in program:
        name, _, value = program.partition("=")
        environment[name] = value
        program, *words = words
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = str(gpu)
    with log.open("ab") as told:
        return subprocess.Popen(
            [str(Path(sys.executable).with_name(program)), *words],
            stdout=told,
            stderr=subprocess.STDOUT,
            env=environment,
        )


def finish(commands: Sequence[tuple[str, Path]], at_a_time: int) -> None:
    """Run commands to their end, some at a time, each GPU in turn.

    Args:
        commands: Each with the file that takes what it says.
        at_a_time: How many go on at the same time.

    Raises:
        SystemExit: One failed.
    """
    gpus = torch.cuda.device_count()
    waiting = [*enumerate(commands)]
    going: list[tuple[tuple[str, Path], subprocess.Popen[bytes]]] = []
    try:
        while waiting or going:
            while waiting and len(going) < at_a_time:
                number, command = waiting.pop(0)
                gpu = number % gpus if gpus else None
                going.append((command, do(*command, gpu)))
            for command, process in [*going]:
                if process.poll() is not None:
                    going.remove((command, process))
                    if process.returncode != 0:
                        raise SystemExit(f"This failed; see {command[1]}: {command[0]}")
            time.sleep(LOOK_S)
    finally:
        # Those that still go on when another one has failed.
        for _, process in going:
            process.terminate()
            process.wait()


def points(plan: Plan, run: Run, count: int) -> list[tuple[int, Path]]:
    """Return checkpoints for the learning curve, evenly spaced, the last one too."""
    found = checkpoints(plan.run(*run))
    count = min(count, len(found))
    return [found[len(found) * (number + 1) // count - 1] for number in range(count)]


def write_curve(plan: Plan, run: Run) -> None:
    """Write success on split val of all checkpoints that were tried."""
    points = []
    for steps in sorted(int(each.name) for each in (plan.run(*run) / "val").iterdir()):
        cells = read_json(plan.run(*run) / "val" / f"{steps}" / SUMMARY)["cells"]
        played = sum(cell["episodes"] for cell in cells)
        solved = sum(cell["successes"] for cell in cells)
        points.append(Point(steps, played, solved))
    LearningCurve(tuple(points)).write(plan.run(*run) / CURVE)
    print(*run, *points, sep="\n", flush=True)


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Return what is asked for, on the command line by default."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="runs/OBSERVATION by default")
    parser.add_argument("--film", type=Path, help="in OUT; /dev/shm is fast")
    parser.add_argument("--tasks", default=",".join(CONTROL_TASKS))
    parser.add_argument("--policies", default=",".join(POLICIES))
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--phases", default=",".join(PHASES), help="some of these")
    parser.add_argument("--observation", default="rgb", choices=OBSERVATIONS)
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--fps", type=int, default=5)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--points", type=int, default=4, help="of the learning curve")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--at-a-time", type=int, default=1, help="evaluations")
    parser.add_argument("--episodes", type=int, default=0, help="of each task; 0: all")
    parser.add_argument("--val", type=int, default=10, help="episodes of each task")
    parser.add_argument("--test", type=int, default=0, help="of each task; 0: all")
    parser.add_argument("--train-s", type=float, default=0.0, help="instead of steps")
    parser.add_argument("--print", action="store_true", help="do nothing")
    args = parser.parse_args(words)
    args.out = args.out or Path("runs", args.observation)
    if unknown := set(args.phases.split(",")) - set(PHASES):
        parser.error(f"{', '.join(unknown)}: valid are {', '.join(PHASES)}")
    return args


def main() -> None:
    """Do what the arguments say."""
    args = arguments()
    plan = Plan(
        out=args.out,
        film=args.film or args.out / "film",
        tasks=args.tasks,
        observation=args.observation,
        size=args.size,
        fps=args.fps,
        steps=args.steps,
        train_s=args.train_s,
        batch=args.batch,
        points=args.points,
        workers=args.workers,
        episodes=args.episodes,
        tests=args.test,
        device="cuda" if torch.cuda.is_available() else "cpu",
    )
    seeds = [int(seed) for seed in args.seeds.split(",")]
    runs = [(name, seed) for seed in seeds for name in args.policies.split(",")]
    if args.print:
        print("\n".join(plan.commands(runs)))
        return
    log = plan.out / "evaluations.log"
    if "data" in args.phases:
        made = plan.out / "data.log"
        finish([(command, made) for command in plan.data_commands()], 1)
    if "train" in args.phases:
        missing = [run for run in runs if not plan.trained(run)]
        for run in missing:
            rmtree(plan.run(*run), ignore_errors=True)
        trainings = [
            (plan.training(*run), plan.run(*run).with_suffix(".log")) for run in missing
        ]
        finish(trainings, len(trainings))
    if "test" in args.phases:
        tests = [
            (plan.test(run, checkpoints(plan.run(*run))[-1][1]), log) for run in runs
        ]
        finish(tests, args.at_a_time)
    if "curve" in args.phases:
        tried = [
            plan.evaluation(path, "val", args.val, plan.run(*run) / "val" / f"{steps}")
            for run in runs
            for steps, path in points(plan, run, args.points)
        ]
        finish([(command, log) for command in tried], args.at_a_time)
        for run in runs:
            write_curve(plan, run)


if __name__ == "__main__":
    main()
