"""Scripts that train and evaluate what the tables need, without training anything."""

import argparse
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import tyro
from tiny_model import ABOUT

import control_baselines
import side_by_side
import train_all
from lemma.core.files import write_json
from lemma.evaluation.experiments.catalog import (
    CONTROL_LEVEL,
    SEEDS,
    TRAININGS,
    selected,
)
from lemma.policies.weights_file import read_metadata, write_weights
from test_repository import options_of
from train_all import Machine

ROUNDS = (1, 2)
SLOTS, GPUS = 2, 2


def check_options(command: str) -> None:
    verb, *words = command.split()[1:]
    given = {word.split("=")[0] for word in words if word.startswith("--")}
    assert given <= options_of(verb), command


def test_each_training_is_done_once_and_each_row_in_each_round() -> None:
    experiments = [*selected("all"), *selected("ablations")]
    jobs, rows = train_all.plan(experiments, SEEDS, ROUNDS)
    assert len(jobs) == len(set(jobs))
    assert {job.name for job in jobs} == set(TRAININGS)
    assert {job for row in rows for job in row.jobs} == set(jobs)
    first, second = ([row for row in rows if row.episodes == n] for n in ROUNDS)
    assert rows == [*first, *second]
    assert len({(row.experiment.name, row.runs) for row in first}) == len(first)
    # Policies that learn nothing, and ablations, have one seed.
    counted = [row.experiment.name for row in first]
    assert counted.count("oracle") == counted.count("no-reach") == 1
    assert counted.count("reachnet") == len(SEEDS)


def test_ablations_are_trained_whichever_seeds_are_asked() -> None:
    experiments = [*selected("reachnet"), *selected("no-reach"), *selected("oracle")]
    jobs, rows = train_all.plan(experiments, SEEDS[1:], ROUNDS[:1])
    trained = {(job.name, job.seed, job.runs) for job in jobs}
    assert trained == {
        ("reachnet-no-reach", SEEDS[0], "runs/ablations"),
        *(("reachnet", seed, f"runs/seed-{seed}") for seed in SEEDS[1:]),
    }
    counted = [row.experiment.name for row in rows]
    assert counted.count("oracle") == counted.count("no-reach") == 1


def test_printed_commands_can_be_given() -> None:
    jobs, rows = train_all.plan(selected("all"), SEEDS[:1], ROUNDS[:1])
    for command in (
        *(job.commands("--compile")[0] for job in jobs[:2]),
        rows[0].command("o", 1),
        rows[0].command("o", 1, "cuda"),
    ):
        check_options(command)
    for observation in control_baselines.OBSERVATIONS:
        for command in control_plan(Path("out"), observation).commands([("act", 0)]):
            if command.startswith("lemma "):
                check_options(command)


def test_what_the_catalog_says_of_control_level_is_what_the_script_does() -> None:
    for one in selected(CONTROL_LEVEL):
        if not one.policy.name.startswith("lerobot:"):
            for command in one.trainings(0):
                check_options(command)
            continue
        program, script, *words = one.training.split()
        assert (program, script) == ("python", "scripts/control_baselines.py")
        asked = tyro.cli(control_baselines.Plan, args=words)
        assert tuple(asked.tasks.split(",")) == one.tasks
        name = one.policy.name.rpartition(":")[2]
        policies = asked.policies.split(",")
        assert name in [asked.run(policy, 0).name for policy in policies]
        assert dict(one.policy.arguments)["hz"] == asked.fps
    told = control_plan(Path("out"), "privileged").commands([("act", 0)])
    assert "--environment-state privileged" in told[1]
    assert "--policy lerobot-privileged:out/seed-0/act-privileged/" in told[-1]


def control_plan(
    out: Path, observation: control_baselines.Observation = "rgb"
) -> control_baselines.Plan:
    return control_baselines.Plan(
        out=out,
        tasks="pass",
        observation=observation,
        cameras="robot_0,robot_1",
        size="64x48",
        train_s=1.0,
        episodes=1,
        tests=1,
    )


def script(folder: Path, name: str, *lines: str) -> str:
    """Return the command of a program of these lines."""
    path = folder / f"{name}.py"
    path.write_text("\n".join(("import pathlib, sys, time", *lines)))
    return f"python {path}"


class Scripted(control_baselines.Plan):
    """Trainings and evaluations are programs of a test."""

    def training(self, name: str, seed: int) -> str:
        return script(
            self.out,
            f"train-{name}",
            f"other = pathlib.Path({str(self.out)!r}, 'other-of-{name}')",
            f"pathlib.Path({str(self.out)!r}, 'other-of-{OTHER[name]}').touch()",
            # Each waits for the other one: they go on at the same time.
            "while not other.exists(): time.sleep(0.01)",
            *(self.lines_of(name, seed, step) for step in range(1, self.points + 1)),
            f"sys.exit({self.episodes})",
        )

    def lines_of(self, name: str, seed: int, step: int) -> str:
        state = self.run(name, seed) / "checkpoints" / f"{step:06d}" / "training_state"
        told = f'{{"share": {step / self.points}}}'
        return (
            f"there = pathlib.Path({str(state)!r}); there.mkdir(parents=True)\n"
            f"(there / 'training_step.json').write_text({told!r})"
        )

    def evaluation(
        self, run: control_baselines.Run, checkpoint: Path, split: str
    ) -> str:
        name = f"{split}-{run[0]}-{checkpoint.parent.name}"
        return script(self.out, name, f"print({name!r})", f"sys.exit({self.tests})")


@pytest.mark.parametrize(
    ("given", "gpu", "seen"),
    [
        ("3,5", 1, "5"),
        ("GPU-a, GPU-b", 0, "GPU-a"),
        (None, 1, "1"),
        ("3,5", None, ""),
        # More than there are: torch counts two.
        ("3,5,7", 1, "5"),
    ],
)
def test_a_command_sees_one_gpu_of_those_that_were_given(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    given: str | None,
    gpu: int | None,
    seen: str,
) -> None:
    monkeypatch.setattr(side_by_side.torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv(side_by_side.VISIBLE, raising=False)
    if given is not None:
        monkeypatch.setenv(side_by_side.VISIBLE, given)
    assert len(side_by_side.visible_gpus()) == 2
    says = script(
        tmp_path,
        "says",
        f"import os; print(repr(os.environ[{side_by_side.VISIBLE!r}]))",
    )
    log = tmp_path / "log"
    assert side_by_side.start(says, log, gpu).wait() == 0
    assert log.read_text().strip() == repr(seen)


OTHER = {"act": "diffusion", "diffusion": "act"}
BOTH = [("act", 0), ("diffusion", 0)]


def scripted(out: Path, **numbers: int) -> Scripted:
    return Scripted(**(vars(control_plan(out)) | {"episodes": 0, "tests": 0} | numbers))


def told(plan: control_baselines.Plan) -> list[str]:
    return (plan.out / "evaluations.log").read_text().split()


def test_trainings_go_on_together_and_all_that_they_save_is_tried(
    tmp_path: Path,
) -> None:
    plan = scripted(tmp_path, points=3)
    control_baselines.work(plan, BOTH, control_baselines.PHASES, 60.0)
    curves = {f"val-{name}-00000{step}" for name in OTHER for step in (1, 2, 3)}
    assert len(told(plan)) == 8
    assert {*told(plan)} == curves | {f"test-{name}-000003" for name in OTHER}
    # They are done, and not trained again.
    control_baselines.work(plan, BOTH, ("train",), 60.0)
    assert len(told(plan)) == 8


def test_a_failure_is_told_when_the_others_have_ended(tmp_path: Path) -> None:
    for number, failing in enumerate(({"episodes": 1}, {"tests": 1})):
        plan = scripted(tmp_path / f"{number}", points=1, **failing)
        plan.out.mkdir()
        with pytest.raises(SystemExit, match="These failed") as failed:
            control_baselines.work(plan, BOTH, control_baselines.PHASES, 60.0)
        words = ("train-", "val-")[number]
        assert all(f"{words}{name}" in str(failed.value) for name in OTHER)
        assert len(told(plan)) == 4


class Rehearsal(Machine):
    """Starts nothing, and notes what it was asked to start."""

    def start(
        self, command: str, log: str, gpu: int | None
    ) -> "subprocess.Popen[bytes]":
        self.begun = [*getattr(self, "begun", []), command]
        going = [each for each in self.training if each[2].poll() is None]
        words = command.split()
        if words[1] == "reproduce":
            assert ("--device cuda" in command) is (gpu == 0)
        else:
            assert gpu is not None
            assert len(going) < SLOTS * GPUS
        if words[1] == "train":
            out = Path(words[words.index("--out") + 1])
            out.mkdir(parents=True)
            write_json(out / train_all.REPORT, {"status": "finished"})
            write_weights(out / train_all.WEIGHTS, {}, replace(ABOUT, command=command))
        if "--teach" in words:
            path = Path(words[words.index("--teach") + 1]) / train_all.WEIGHTS
            about = read_metadata(path)
            told = replace(about, command=f"{about.command}; {command}")
            write_weights(path, {}, told)
        return subprocess.Popen(["true"])


@pytest.fixture
def options() -> argparse.Namespace:
    forever = float("inf")
    return argparse.Namespace(
        until_s=forever,
        stop_s=forever,
        train="",
        out="results",
        workers=1,
        device="cpu",
    )


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_rows_are_played_when_their_weights_are_there(
    device: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: argparse.Namespace,
) -> None:
    options.device = device
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train_all, "LOOK_S", 0.01)
    jobs, rows = train_all.plan(selected("paper"), SEEDS[:2], ROUNDS)
    wanted = {row.command("results", 1, device): row for row in rows}
    machine = Rehearsal(tmp_path / "logs", SLOTS, GPUS)
    assert train_all.work(machine, jobs, list(rows), options) == []
    begun = machine.begun
    assert {c for c in begun if " reproduce " in c} == set(wanted)
    for command, row in wanted.items():
        made = [begun.index(one) for job in row.jobs for one in job.commands("")]
        assert max(made) < begun.index(command)
    # The same command goes on where it was stopped: nothing is trained again.
    again = Rehearsal(tmp_path / "logs", SLOTS, GPUS)
    train_all.work(again, jobs, list(rows), options)
    assert all(" reproduce " in command for command in again.begun)


@pytest.mark.parametrize(
    ("status", "done"),
    [("finished", True), ("time is up", True), ("interrupted", False)],
)
def test_an_interrupted_training_goes_on(
    status: str, done: bool, tmp_path: Path
) -> None:
    job = train_all.Job("cliport", 1, str(tmp_path))
    assert not job.done
    write_json(tmp_path / "cliport" / train_all.REPORT, {"status": status})
    assert job.done is done
