"""Experiments: every row can be carried out, and is compared with its lines."""

import copy
import json
import shlex
from dataclasses import replace
from functools import wraps
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import tyro
from command import run
from made_up import row, step

import control_baselines
from lemma.bench import evaluation_checks
from lemma.bench.evaluation_checks import NETWORK, published_sample
from lemma.core.arguments import decode
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.files import write_json
from lemma.core.workers.pool import Serial
from lemma.evaluation.analysis.result import check_lines, read_result
from lemma.evaluation.experiments import reproduction
from lemma.evaluation.experiments.catalog import (
    ABLATION_EPISODES,
    ABLATIONS,
    ALL,
    CONTROL_LEVEL,
    EXPERIMENTS,
    SEEDS,
    SUITES,
    TRAININGS,
    selected,
)
from lemma.evaluation.experiments.reproduction import (
    MissingWeightsError,
    Reproduction,
    commands,
    compared,
)
from lemma.evaluation.lines import packed_beside, read_lines, write_packed
from lemma.evaluation.records import key_of
from lemma.evaluation.run.loading import learned_parts
from lemma.policies.spec import CONTROL, ORACLE, PolicySpec
from lemma.policies.training.config import TrainingConfig, model_options
from lemma.policies.weights import published_weights
from lemma.policies.weights_file import TIME_LIMIT
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.names import LADDER
from lemma.tasks.suite import SUITE


def test_every_part_has_a_training_and_every_training_is_needed() -> None:
    here = [one for one in EXPERIMENTS.values() if not one.training]
    parts = {part for one in here for part in learned_parts(one.policy.name)}
    assert parts == set(TRAININGS)


@pytest.mark.parametrize("name", list(TRAININGS))
def test_the_command_line_takes_the_training(name: str) -> None:
    pytest.importorskip("torch")
    from lemma.policies.models.catalog import MODELS  # noqa: PLC0415

    words = shlex.split(TRAININGS[name].command("runs/seed-2", 2))
    assert words[:2] == ["lemma", "train"]
    config = tyro.cli(TrainingConfig, args=words[2:])
    assert (config.seed, config.out) == (2, Path("runs/seed-2") / name)
    _, options = MODELS[config.model]
    decode(options, model_options(config.options))
    # By samples alone: no clock decides what is trained.
    assert config.samples is not None
    assert (config.steps, config.time_limit_s) == (None, None)


@pytest.mark.parametrize("verb", ["generate", "render", "reproduce"])
def test_the_command_line_takes_what_is_printed(verb: str) -> None:
    lines = {
        line
        for suite in (ALL, ABLATIONS)
        for line in commands(selected(suite))
        if line.startswith(f"lemma {verb} ")
    }
    assert len(lines) >= 2
    function = getattr(import_module(f"lemma.cli.{verb}"), verb)

    @wraps(function)
    def accept(*_: object, **__: object) -> str:
        return "taken"

    for line in lines:
        words = shlex.split(line)[2:]
        assert tyro.cli(accept, args=words) == "taken"
        with pytest.raises(SystemExit):
            tyro.cli(accept, args=[*words, "--no-such-option", "1"])


def test_ablations_differ_in_one_thing_each_and_not_in_their_length() -> None:
    found = {}
    for one in selected(ABLATIONS):
        words = shlex.split(TRAININGS[one.policy.name].command("runs", 0))[2:]
        found[one.name] = replace(tyro.cli(TrainingConfig, args=words), out=Path("out"))
    complete = found.pop("complete")
    assert all(config.samples == complete.samples for config in found.values())
    assert complete not in found.values()
    assert len(set(map(repr, found.values()))) == len(found)


def test_suites_share_out_the_experiments() -> None:
    suites = [one.name for suite in SUITES for one in selected(suite)]
    assert sorted(suites) == sorted(EXPERIMENTS)
    left_out = {ABLATIONS, CONTROL_LEVEL}
    assert {one.suite for one in selected(ALL)} == {*SUITES} - left_out
    assert [one.name for one in selected("oracle")] == ["oracle"]
    with pytest.raises(UnknownNameError, match="paper"):
        selected("papr")


def test_figures_of_the_paper_are_of_the_suite() -> None:
    for one in selected("paper"):
        for kind, figures in one.paper.items():
            assert kind in EVALUATION_KINDS
            assert set(figures.tasks) == set(SUITE)
            mean = sum(task.mean for task in figures.tasks.values()) / len(SUITE)
            assert mean == pytest.approx(figures.mean.mean, abs=0.006)
        assert set(one.paper) == {"high_level", "human"}


def test_what_another_script_trains_is_printed_as_well() -> None:
    every = commands(selected(CONTROL_LEVEL))
    expert, *asked = selected(CONTROL_LEVEL)
    assert every[0] == f"lemma reproduce {expert.name}"
    asked_seeds = [(one, seed) for one in asked for seed in one.seeds]
    rows = [
        f"lemma reproduce {one.name} --weights runs/seed-{seed}"
        for one, seed in asked_seeds
    ]
    assert [line for line in every if line.startswith("lemma reproduce")][1:] == rows
    for (one, seed), line in zip(asked_seeds, rows, strict=True):
        made = [every.index(command) for command in one.trainings(seed)]
        assert max(made) < every.index(line)
        assert set(one.tasks) < set(LADDER)
    keypose = EXPERIMENTS["keypose"]
    assert keypose.seeds == SEEDS
    told = [line for line in every if line.startswith("lemma train keypose")]
    runs = [f"--out runs/seed-{seed}/keypose --seed {seed} " for seed in SEEDS]
    assert all(run in line for run, line in zip(runs, told, strict=True))
    # A command that makes the weights of two rows is printed once.
    assert len(every) == len(set(every))


def test_every_seed_is_trained_once_for_each_part() -> None:
    every = commands(selected("paper"))
    lines = [line for line in every if not line.startswith("# ")]
    assert len(lines) == len(set(lines)) == 4 + 3 * (3 + 5)
    published = published_weights()
    parts = ("episodic-transformer", "cliport", "m-cliport")
    cut = [name for name in parts if published[name]["ended"] == "time limit"]
    assert [line.split()[5][:-1] for line in every if line not in lines] == cut
    assert all(
        each.startswith("lemma reproduce") for each in commands(selected("oracle"))
    )
    assert sum("train cliport" in line for line in lines) == 3
    assert "lemma reproduce m-cliport --weights runs/seed-1" in lines
    assert all("--seed 0" in x for x in commands(selected(ABLATIONS)) if "train" in x)


def test_beside_its_training_stands_how_a_published_one_was_really_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entry = published_weights()["cliport"]
    shorter = {**entry, "ended": TIME_LIMIT, "steps": 12}
    monkeypatch.setattr(reproduction, "published_weights", lambda: {"cliport": shorter})
    told = [x for x in commands(selected("paper")) if x.startswith("# ")]
    (line,) = told
    assert entry["command"] in line
    assert "cliport" in line
    assert "ended by its time limit after 12 steps" in line


@pytest.mark.slow
def test_an_experiment_leaves_two_small_files(tmp_path: Path) -> None:
    plan = Reproduction(out=tmp_path, split="val", episodes=1)
    oracle = replace(
        EXPERIMENTS["oracle"], kinds=("high_level",), tasks=("pass", "hook")
    )
    path = plan.run(oracle, Serial())
    assert path == tmp_path / "oracle" / "seed-0.json"
    made = read_result(path)
    assert made.experiment == "oracle"
    assert made.command == "lemma reproduce oracle --split val --episodes 1"
    assert sum(cell.successes for cell in made.cells) == 2
    (tmp_path / "oracle" / "seed-0" / "episodes.jsonl").unlink()
    packed = packed_beside(path)
    check_lines(made, read_lines(packed), path, packed)
    # Played again, which takes another time.
    before = path.read_bytes(), packed.read_bytes()
    assert plan.run(oracle, Serial()) == path
    assert (path.read_bytes(), packed.read_bytes()) == before


def test_missing_weights_are_explained(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    plan = Reproduction(out=tmp_path, weights=tmp_path)
    with pytest.raises(MissingWeightsError, match="lemma train episodic-transformer"):
        plan.config(EXPERIMENTS["et-cliport-single-step"])
    with pytest.raises(MissingWeightsError, match="augmentation"):
        Reproduction(out=tmp_path).config(EXPERIMENTS["no-palette"])
    for name, how in (
        ("act-reach", r"control_baselines.py .* --label reach "),
        ("keypose", ".* && lemma train keypose"),
    ):
        one = EXPERIMENTS[name]
        with pytest.raises(MissingWeightsError, match=f"are not in .*{how}"):
            Reproduction(out=tmp_path, weights=tmp_path).config(one)
    none = replace(one, policy=PolicySpec("lerobot-privileged:nobody"))
    with pytest.raises(MissingWeightsError, match=r"are not published\. Make them"):
        Reproduction(out=tmp_path).config(none)


def test_trainings_of_lerobot_are_found(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    name = "act-lift"
    plan = control_baselines.Plan(label="lift")
    made = tmp_path / plan.run("act", 1).relative_to(plan.out)
    told = made / "checkpoints/last/pretrained_model"
    told.mkdir(parents=True)
    (told / "model.safetensors").write_bytes(b"")
    (told / "config.json").write_text('{"type": "act"}')
    training = {"seed": 1, "dataset": {"repo_id": "lemma/control"}}
    write_json(told / "train_config.json", training)
    found = Reproduction(out=tmp_path / "out", weights=tmp_path / "seed-1")
    config, seed = found.config(EXPERIMENTS[name])
    assert seed == 1
    assert config.out == tmp_path / "out" / name / "seed-1"
    prefix = EXPERIMENTS[name].policy.name.removesuffix(name)
    assert config.policy.name == f"{prefix}{told}"


def test_the_page_says_how_long_ablations_are_trained() -> None:
    text = (Path(__file__).parents[3] / "docs" / "evaluation.md").read_text("utf-8")
    few = f"--episodes-per-task {ABLATION_EPISODES}"
    for one in selected(ABLATIONS):
        assert TRAININGS[one.policy.name].arguments.startswith(few)
    assert few in text
    assert str(TRAININGS["reachnet-complete"].samples) in text.replace(",", "")


RESULTS = Path(__file__).parents[3] / "results"


def test_what_differs_is_told() -> None:
    poses = {
        "robot": "robot_0",
        "primitive": "move",
        "pick": [0.1, 0.2, 0.3],
        "place": [0.4, 0.5, 0.6],
    }
    steps = [{**step(), "grounded": copy.deepcopy(poses)} for _ in range(2)]
    line: Any = row(success=True, steps=steps)
    assert compared([(line, line)]).ok
    now = copy.deepcopy(line)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0005
    near = compared([(line, now)])
    assert near.ok
    assert near.farthest_m == pytest.approx(0.0005)
    now["subtasks"][0]["grounded"]["pick"][0] += 0.0010
    now["subtasks"][0]["outcome"] = "dropped"
    now["subtasks"][1]["grounded"]["place"][2] += 0.02
    now["success"] = now["lenient"]["success"] = False
    (told,) = compared([(line, now)]).differing
    assert told.partition(": ")[2].split("; ") == [
        "success was True, is False",
        "leniently, success was True, is False",
        "sub-task 1: outcome was success, is dropped",
        "sub-task 1: its pick moved by 1.50 mm and 0.0000 rad",
        "sub-task 2: its place moved by 0.00 mm and 0.0200 rad",
    ]
    now["subtasks"][0]["grounded"] = None
    del now["subtasks"][1]
    (told,) = compared([(line, now)]).differing
    assert "2 sub-tasks, now 1" in told
    assert "sub-task 1: poses were {'robot'" in told
    with pytest.raises(InvalidConfigError, match="No episode"):
        compared([])


def test_the_sample_in_the_package_is_of_published_lines() -> None:
    sample = published_sample()
    assert {*sample} == {NETWORK, ORACLE, CONTROL}
    assert all(sample.values())
    for name in (NETWORK, ORACLE):
        path = packed_beside(EXPERIMENTS[name].summary_path(RESULTS, 0))
        assert path.is_file(), (
            f"The sample in the package is of {path}, which is not there."
        )
        lines = {key_of(row): row for row in read_lines(path)}
        for line in sample[name]:
            assert line == lines.get(key_of(line)), (
                f"src/lemma/bench/published.json is not of the lines of {path}: it has "
                f"another episode {'/'.join(map(str, key_of(line)))}."
            )


@pytest.mark.slow
def test_reproduce_says_whether_policies_decide_as_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = packed_beside(EXPERIMENTS["oracle"].summary_path(RESULTS, 0))
    lines = [dict(r) for r in read_lines(path) if r["task"] in ("stack", "hook")]
    lines = [r for r in lines if r["instruction_kind"] == "human"]
    kept = packed_beside(EXPERIMENTS["oracle"].summary_path(tmp_path, 0))
    kept.parent.mkdir()
    for success, code in ((True, 0), (False, 1)):
        # One of them says something else.
        lines[0]["success"] = success
        write_packed(kept, lines)
        assert run("reproduce", "oracle", "--check", "--out", tmp_path) == code
        told = capsys.readouterr().out
        assert f"oracle: {2 - code} of 2 episodes are equal" in told


@pytest.mark.slow
def test_rows_at_control_level_are_checked_without_lerobot(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    results = Path(__file__).parents[3] / "results"
    assert run("reproduce", "oracle-control", "--check", "--out", results) == 0
    told = capsys.readouterr().out
    assert "oracle-control: 14 of 14 episodes are equal" in " ".join(told.split())
    # Nor can it be checked with it, because its weights do not ship.
    for found, why in (None, "lerobot is not"), (True, "are not published"):
        monkeypatch.setattr("lemma.cli.reproduce.find_spec", lambda _, it=found: it)
        assert run("reproduce", "act-reach", "--check", "--out", results) == 1
        skipped = capsys.readouterr().err
        assert "Skipped act-reach" in skipped
        assert why in " ".join(skipped.split())
        assert "Nothing was compared." in skipped


@pytest.mark.slow
@pytest.mark.render
def test_the_doctor_plays_a_sample_of_each_level(
    capsys: pytest.CaptureFixture[str],
) -> None:
    run("doctor", "--evaluation", "--json")
    checks = json.loads(capsys.readouterr().out)["checks"]
    found = {check["name"]: check for check in checks}
    for name in ("protocol", "published decisions", "control level: the expert"):
        assert found[name]["ok"], found[name]
    assert found["plan and poses: reachnet"]["ok"]


def test_what_differs_from_published_lines_is_no_ok(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = published_sample()[ORACLE][0]
    changed = {**line, "elapsed_s": 1.0}
    monkeypatch.setattr(
        evaluation_checks,
        "published_sample",
        lambda: {"reachnet": [changed], "oracle": []},
    )
    # All that needs no network.
    found = {one.name: one for one in islice(evaluation_checks.check_evaluation(), 4)}
    assert not found["published decisions"].ok
    assert "elapsed_s is 1.0, and" in found["published decisions"].found
    # Nothing to compare is no agreement.
    assert not found["skill level: the expert"].ok
    assert found["actions, normalised and back"].ok
