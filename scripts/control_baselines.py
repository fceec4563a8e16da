"""Train and evaluate LeRobot policies at control level.

In an environment with lerobot, such as the one that ``make test-lerobot`` makes:

    python scripts/control_baselines.py --print
    python scripts/control_baselines.py --seeds 0,1,2
    python scripts/control_baselines.py --observation privileged
    python scripts/control_baselines.py --suite ladder --label reach \
        --tasks reach_fixed,reach_varied,reach --cameras robot_0_reach,robot_0_wrist \
        --size 224x224 --chunk 16 --executed 5 --state full --displaced 0.5 \
        --train-s 600

It runs the commands that it prints. First it generates demonstrations and renders their
camera images as arrays in memory. Then it runs one training for each policy and seed,
all at the same time, distributed over the GPUs. Meanwhile the CPUs evaluate every
checkpoint on split val, for the learning curve, and the last one of each training on
split test. Finished parts are kept, and the same command resumes, but an unfinished
training begins again. ``--phases`` selects parts; ``--train-s`` and ``--stop-s`` are
time limits.

One policy learns all tasks. Its input has the instruction as numbers, because LeRobot's
ACT and Diffusion Policy do not read text. With ``--observation privileged`` its input
is privileged state, poses and goal, without images: an oracle.
"""

import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from shutil import rmtree
from typing import Annotated, Literal

import tyro

from learning_curves import CURVE, LearningCurve, Point
from lemma.core.files import read_json, write_json
from lemma.evaluation.analysis.result import read_result
from lemma.evaluation.records import SUMMARY
from lemma.policies.class_path import LEROBOT, LEROBOT_PRIVILEGED
from side_by_side import start, visible_gpus

POLICIES = ("act", "diffusion")
Observation = Literal["rgb", "privileged"]
OBSERVATIONS: tuple[Observation, ...] = ("rgb", "privileged")
PHASES = ("data", "train", "test", "curve")
TRAINER = "scripts/train_lerobot_policy.py"
CURVE_SPLIT = "val"
WEIGHTS = "pretrained_model"
"""Folder of the policy in a checkpoint."""
STATE = "training_state/training_step.json"
"""File with the number of steps in a checkpoint."""
LOOK_S = 0.5

Run = tuple[str, int]
"""A policy and a seed."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The options of the command."""

    out: Path = Path("runs")
    film_folder: Annotated[Path | None, tyro.conf.arg(name="film")] = None
    """Folder of the rendered demonstrations; in OUT by default. /dev/shm is fast."""
    tasks: str = "pass,stack,poke,hook"
    suite: str = "lemma"
    """Suite of the tasks."""
    label: str = ""
    """Added to the names of all folders, so that several such trainings share OUT."""
    policies: str = ",".join(POLICIES)
    seeds: str = "0"
    phases: str = ",".join(PHASES)
    """Phases to run, separated by commas."""
    observation: Observation = "rgb"
    cameras: str = ""
    """Names of cameras, separated by commas; those of the robots if empty."""
    size: str = "160x120"
    fps: int = 5
    displaced: float = 0.0
    """Share of frames for training in which the busy arm is moved off its way."""
    steps: int = 20_000
    train_s: float = 0.0
    """Duration of a training [s], instead of a number of steps; 0 to use steps."""
    batch: int = 128
    chunk: int = 0
    """Predicted actions; 0 for the default of each policy."""
    executed: int = 0
    """Executed actions of a chunk; 0 for the default of each policy."""
    state: Literal["", "full", "grippers"] = ""
    """State of the arms in the policy's input; without a value, only the openings of
    grippers if it has images."""
    points: int = 4
    """Number of checkpoints for the learning curve."""
    workers: int = os.cpu_count() or 1
    episodes: int = 0
    """Episodes of each task in split train; 0 for all."""
    vals: Annotated[int, tyro.conf.arg(name="val")] = 10
    """Episodes of each task in split val."""
    tests: Annotated[int, tyro.conf.arg(name="test")] = 0
    """Episodes of each task in split test; 0 for all."""
    stop_s: float = float("inf")
    """Time limit of the whole command [s]."""
    print: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Only print the commands."""

    @property
    def film(self) -> Path:
        """Folder of the rendered demonstrations."""
        return self.film_folder or self.out / self.labeled(f"film-{self.observation}")

    @property
    def recipe(self) -> Path:
        """Folder of the demonstrations."""
        return self.out / self.labeled("recipe")

    def labeled(self, name: str) -> str:
        """Return a name with the label of these trainings."""
        return f"{name}-{self.label}" if self.label else name

    def run(self, name: str, seed: int) -> Path:
        """Return the folder of a training, in which ``lemma reproduce`` finds it."""
        suffix = "" if self.observation == OBSERVATIONS[0] else f"-{self.observation}"
        return self.out / f"seed-{seed}" / self.labeled(f"{name}{suffix}")

    def data_commands(self) -> list[str]:
        """Return the commands that make the training data."""
        episodes = f" --episodes {self.episodes}" if self.episodes else ""
        state = "sentence" if self.observation == OBSERVATIONS[0] else self.observation
        seen = f"--cameras {self.cameras} " if self.cameras else ""
        moved = f"--displaced {self.displaced:g} " if self.displaced else ""
        return [
            f"lemma generate --suite {self.suite} --tasks {self.tasks} "
            f"--split train{episodes} "
            f"--out {self.recipe} --workers {self.workers}",
            f"python {TRAINER} film {self.recipe} {self.film} --tasks {self.tasks} "
            f"--size {self.size} {seen}{moved}--fps {self.fps} "
            f"--environment-state {state} --workers {self.workers}",
        ]

    def training(self, name: str, seed: int) -> str:
        """Return the command of a training."""
        long = f"--steps {self.steps}"
        if self.train_s:
            long = f"--train-s {self.train_s:g}"
        # With the poses of hands as input a policy infers the goal from their motion,
        # and ignores the images.
        usual = "grippers" if self.observation == OBSERVATIONS[0] else "full"
        lengths = {"chunk": self.chunk, "executed": self.executed}
        changed = "".join(f" --{name} {n}" for name, n in lengths.items() if n)
        return (
            f"python {TRAINER} train {self.film} {self.run(name, seed)} "
            f"--policy {name} --seed {seed} {long} "
            f"--batch {self.batch} --points {self.points} "
            f"--state {self.state or usual}{changed}"
        )

    def evaluation(self, run: Run, checkpoint: Path, split: str) -> str:
        """Return the command that evaluates a checkpoint."""
        out, episodes = self.run(*run) / split, self.tests
        if split == CURVE_SPLIT:
            out, episodes = out / checkpoint.parent.name, self.vals
        some = f" --episodes {episodes}" if episodes else ""
        kind = LEROBOT if self.observation == OBSERVATIONS[0] else LEROBOT_PRIVILEGED
        return (
            f"lemma evaluate --policy {kind}{checkpoint} "
            f"--suite {self.suite} --tasks {self.tasks} "
            f"--policy-args hz={self.fps} --split {split}{some} "
            f"--workers {self.workers} --out {out}"
        )

    def trained(self, run: Run) -> bool:
        """Return whether a training is finished."""
        saved = checkpoints(self.run(*run))
        if not saved:
            return False
        _, last = saved[-1]
        state: dict[str, float] = read_json(last.parent / STATE)
        return state["share"] >= 1.0

    def commands(self, runs: Sequence[Run]) -> list[str]:
        """Return all commands except those of the learning curve."""
        last = f"checkpoints/last/{WEIGHTS}"
        return [
            *self.data_commands(),
            *(self.training(*run) for run in runs),
            *(self.evaluation(run, self.run(*run) / last, "test") for run in runs),
        ]


def checkpoints(run: Path) -> list[tuple[int, Path]]:
    """Return the complete checkpoints of a training with their numbers of steps."""
    # The file with the number of steps is written last.
    whole = (run / "checkpoints").glob(f"[0-9]*/{STATE}")
    return sorted((int(each.parts[-3]), each.parents[1] / WEIGHTS) for each in whole)


def playable(plan: Plan, runs: Sequence[Run], phases: Sequence[str]) -> Iterator[str]:
    """Yield evaluations of existing checkpoints, first those of finished trainings."""
    if "test" in phases:
        for run in runs:
            if plan.trained(run):
                yield plan.evaluation(run, checkpoints(plan.run(*run))[-1][1], "test")
    if "curve" in phases:
        for run in runs:
            for _, path in checkpoints(plan.run(*run)):
                yield plan.evaluation(run, path, CURVE_SPLIT)


def work(plan: Plan, runs: Sequence[Run], phases: Sequence[str], stop_s: float) -> None:
    """Train, and evaluate existing checkpoints meanwhile, until all is done.

    Args:
        plan: Options of the command.
        runs: Trainings.
        phases: Some of :data:`PHASES`.
        stop_s: Time at which running commands are ended [s].

    Raises:
        SystemExit: A command failed; the others finish first.
    """
    begin, gpus = time.monotonic(), len(visible_gpus())
    going: dict[str, subprocess.Popen[bytes]] = {}
    missing = [run for run in runs if not plan.trained(run)]
    for number, run in enumerate(missing if "train" in phases else ()):
        rmtree(plan.run(*run), ignore_errors=True)
        command, log = plan.training(*run), plan.run(*run).with_suffix(".log")
        going[command] = start(command, log, number % gpus if gpus else None)
    playing, played, failed = "", set(), []
    try:
        while time.monotonic() - begin < stop_s:
            for command in [one for one in going if going[one].poll() is not None]:
                if going.pop(command).returncode:
                    failed.append(command)
            if playing not in going:
                ready = playable(plan, runs, phases)
                playing = next((one for one in ready if one not in played), "")
                if playing:
                    played.add(playing)
                    going[playing] = start(playing, plan.out / "evaluations.log")
            if not going:
                break
            time.sleep(LOOK_S)
    finally:
        for process in going.values():
            # An evaluation keeps finished episodes. Not SIGINT, because background
            # processes of a shell ignore it.
            process.terminate()
            process.wait()
    if failed:
        raise SystemExit(
            f"These failed; see *.log in {plan.out}:\n" + "\n".join(failed)
        )


def write_curve(plan: Plan, run: Run) -> None:
    """Write the success on split val of all evaluated checkpoints."""
    points = []
    for found in (plan.run(*run) / CURVE_SPLIT).glob(f"*/{SUMMARY}"):
        cells = read_result(found).cells
        played = sum(cell.episodes for cell in cells)
        solved = sum(cell.successes for cell in cells)
        points.append(Point(int(found.parent.name), played, solved))
    if points:
        points.sort(key=attrgetter("steps"))
        curve = LearningCurve(tuple(points))
        write_json(plan.run(*run) / CURVE, asdict(curve))
        print(*run, *points, sep="\n", flush=True)


def main() -> None:
    """Run the command line."""
    plan = tyro.cli(Plan, description=__doc__)
    phases = plan.phases.split(",")
    if unknown := set(phases) - set(PHASES):
        raise SystemExit(f"{', '.join(unknown)}: valid are {', '.join(PHASES)}")
    seeds = [int(seed) for seed in plan.seeds.split(",")]
    runs = [(name, seed) for seed in seeds for name in plan.policies.split(",")]
    if plan.print:
        print("\n".join(plan.commands(runs)))
        return
    begin = time.monotonic()
    if "data" in phases:
        for command in plan.data_commands():
            if start(command, plan.out / "data.log").wait():
                raise SystemExit(f"This failed; see {plan.out}/data.log: {command}")
    try:
        used_s = time.monotonic() - begin
        work(plan, runs, phases, plan.stop_s - used_s)
    finally:
        for run in runs:
            write_curve(plan, run)


if __name__ == "__main__":
    main()
