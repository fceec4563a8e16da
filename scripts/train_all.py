"""Train the weights of the tables and evaluate their rows, on one machine with GPUs.

    python scripts/train_all.py --print
    python scripts/train_all.py --slots 3 --episodes 20,60 --until-s 1200 --stop-s 1700

It runs the commands of ``lemma reproduce all --print`` in less time: several trainings
share a GPU, because none uses it fully, and rows are evaluated as soon as their weights
exist: on the CPUs, or with ``--device cuda`` also on the first GPU. Finished parts are
kept, so the same command resumes. It needs the rendered data, see ``--print``.
"""

import argparse
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lemma.core.files import read_json
from lemma.evaluation.experiments.catalog import (
    ABLATIONS,
    ALL,
    DATA_COMMANDS,
    SEEDS,
    TRAININGS,
    Experiment,
    selected,
)
from lemma.evaluation.run.loading import learned_parts
from lemma.policies.training.run import REPORT, WEIGHTS
from lemma.policies.weights_file import read_metadata
from side_by_side import start, visible_gpus

LOOK_S = 1.0


@dataclass(frozen=True)
class Job:
    """One training of one seed."""

    name: str
    seed: int
    runs: str

    @property
    def done(self) -> bool:
        """Whether it has ended, other than by an interruption."""
        return not self.left("")

    def commands(self, more: str) -> tuple[str, ...]:
        """Return the command lines.

        Args:
            more: Further arguments of the first, which do not affect the result.
        """
        first, *then = TRAININGS[self.name].commands(self.runs, self.seed)
        return (f"{first} {more}".strip(), *then)

    def left(self, more: str) -> tuple[str, ...]:
        """Return the command lines that have not ended yet; see :meth:`commands`."""
        run, commands = Path(self.runs) / self.name, self.commands(more)
        report = run / REPORT
        if not report.is_file() or read_json(report)["status"] == "interrupted":
            return commands
        if not commands[1:]:
            return ()
        ended = read_metadata(run / WEIGHTS).command.split("; ")
        return tuple(one for one in commands[1:] if one not in ended)


@dataclass(frozen=True)
class Row:
    """One row of a table, for one seed."""

    experiment: Experiment
    jobs: tuple[Job, ...]
    runs: str
    episodes: int

    def command(self, out: str, workers: int, device: str = "cpu") -> str:
        """Return the command line."""
        weights = f" --weights {self.runs}" if self.jobs else ""
        place = f" --device {device}" if device != "cpu" else ""
        return (
            f"lemma reproduce {self.experiment.name}{weights}{place} --out {out} "
            f"--episodes {self.episodes} --workers {workers}"
        )


def plan(
    experiments: Sequence[Experiment], seeds: Sequence[int], rounds: Sequence[int]
) -> tuple[list[Job], list[Row]]:
    """Return trainings without duplicates, and rows, round by round.

    Ablations and policies without training have only the first of all seeds, whichever
    seeds are selected.
    """
    jobs: dict[Job, None] = {}
    rows = []
    for episodes in rounds:
        for asked in seeds:
            for experiment in experiments:
                learned = learned_parts(experiment.policy.name)
                alone = experiment.suite == ABLATIONS or not learned
                if alone and asked != seeds[0]:
                    continue
                seed = SEEDS[0] if alone else asked
                runs = experiment.runs(seed)
                needed = tuple(Job(name, seed, runs) for name in learned)
                jobs |= dict.fromkeys(needed)
                rows.append(Row(experiment, needed, runs, episodes))
    return list(jobs), rows


@dataclass
class Machine:
    """Concurrent processes of this machine."""

    logs: Path
    slots: int
    """Number of trainings per GPU."""
    gpus: int = field(default_factory=lambda: max(1, len(visible_gpus())))
    training: list[tuple[Job, int, "subprocess.Popen[bytes]"]] = field(
        default_factory=list
    )
    playing: "subprocess.Popen[bytes] | None" = None

    def start(
        self, command: str, log: str, gpu: int | None
    ) -> "subprocess.Popen[bytes]":
        """Start a command of this environment, with one GPU or none."""
        return start(command, self.logs / f"{log}.log", gpu)

    def free_gpu(self) -> int | None:
        """Return the GPU with the fewest trainings, if it has a slot."""
        load = [sum(gpu == n for _, gpu, _ in self.training) for n in range(self.gpus)]
        least = min(load)
        return load.index(least) if least < self.slots else None

    def reap(self) -> list[tuple[Job, bool]]:
        """Remove ended trainings, and return them and whether each went well."""
        ended = [each for each in self.training if each[2].poll() is not None]
        self.training = [each for each in self.training if each not in ended]
        return [(job, process.returncode == 0) for job, _, process in ended]

    def stop(self) -> None:
        """End all processes; lines of finished episodes are kept."""
        going = [process for _, _, process in self.training]
        if self.playing is not None and self.playing.poll() is None:
            going.append(self.playing)
        for process in going:
            # Not SIGINT, because background processes of a shell ignore it.
            process.terminate()
        for process in going:
            process.wait()


def work(
    machine: Machine, jobs: list[Job], rows: list[Row], args: argparse.Namespace
) -> list[Job]:
    """Train and evaluate until all is done, or the time is over.

    Returns:
        Trainings that failed.
    """
    begin = time.monotonic()
    waiting = [job for job in jobs if not job.done]
    failed: list[Job] = []
    while time.monotonic() - begin < args.stop_s:
        for job, good in machine.reap():
            if not good:
                failed.append(job)
            elif not job.done:
                waiting.insert(0, job)
        gpu = machine.free_gpu()
        if waiting and gpu is not None and time.monotonic() - begin < args.until_s:
            job = waiting.pop(0)
            name = f"{job.name}-{job.seed}"
            command = job.left(args.train)[0]
            machine.training.append((job, gpu, machine.start(command, name, gpu)))
            continue
        if machine.playing is None or machine.playing.poll() is not None:
            ready = (row for row in rows if all(job.done for job in row.jobs))
            row = next(ready, None)
            if row is not None:
                rows.remove(row)
                command = row.command(args.out, args.workers, args.device)
                on = None if args.device == "cpu" else 0
                machine.playing = machine.start(command, "rows", on)
                continue
            if not machine.training and (not waiting or gpu is None):
                break
            late = time.monotonic() - begin >= args.until_s
            if not machine.training and late:
                break
        time.sleep(LOOK_S)
    machine.stop()
    return failed


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suites", default=ALL, help="or names of experiments")
    parser.add_argument("--seeds", default=",".join(map(str, SEEDS)))
    parser.add_argument("--out", default="results")
    parser.add_argument("--logs", type=Path, default=Path("runs/logs"))
    parser.add_argument("--episodes", default="60", help="of each task, by round")
    parser.add_argument("--slots", type=int, default=2, help="trainings of a GPU")
    parser.add_argument(
        "--device",
        choices=("cpu", "cuda"),
        default="cpu",
        help="cuda: rows use a GPU, too",
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--train", default="--shared-images --compile", help="more for lemma train"
    )
    parser.add_argument("--until-s", type=float, default=float("inf"))
    parser.add_argument("--stop-s", type=float, default=float("inf"))
    parser.add_argument("--print", action="store_true", help="do nothing")
    args = parser.parse_args()
    experiments = [one for name in args.suites.split(",") for one in selected(name)]
    jobs, rows = plan(
        experiments,
        [int(seed) for seed in args.seeds.split(",")],
        [int(count) for count in args.episodes.split(",")],
    )
    if args.print:
        commands = [
            *DATA_COMMANDS,
            *(command for job in jobs for command in job.commands(args.train)),
            *(row.command(args.out, args.workers, args.device) for row in rows),
        ]
        print("\n".join(commands))
        return
    failed = work(Machine(args.logs, args.slots), jobs, rows, args)
    if failed:
        names = ", ".join(f"{job.name} with seed {job.seed}" for job in failed)
        raise SystemExit(f"These failed; see {args.logs}: {names}")


if __name__ == "__main__":
    main()
