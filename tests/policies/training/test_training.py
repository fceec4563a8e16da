import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import tiny_model
import torch
from painted_keyframes import painted, painted_recovery  # noqa: F401 - fixtures
from safetensors.torch import load_file
from tiers import slow_but
from tiny_model import NAME, Tiny, TinyConfig, config

from lemma.core.arguments import decode
from lemma.core.errors import InvalidConfigError
from lemma.policies.batch import Batch
from lemma.policies.frames import Frames
from lemma.policies.models.catalog import MODELS
from lemma.policies.training import loop as loop
from lemma.policies.training.config import (
    DEFAULTS,
    Augmentation,
    TrainingConfig,
)
from lemma.policies.training.distributed import ProcessGroup
from lemma.policies.training.loader import AHEAD, BatchLoader, Sampler
from lemma.policies.training.loop import train
from lemma.policies.training.run import training_units
from lemma.policies.training.speed import measure_training
from lemma.policies.training.step import Trainer, learning_rate
from lemma.policies.weights_file import read_metadata

HERE = Path(__file__).parent
ALONE = ProcessGroup(0, 1, torch.device("cpu"))

tiny_model.register()
# As in the processes that are started here; more would only wait for each other.
torch.set_num_threads(1)


def test_speed_is_measured_and_nothing_is_written(data: Path, tmp_path: Path) -> None:
    found = measure_training(config(data, tmp_path / "none"))
    assert found["samples_per_s"] > 0
    assert found["frames_per_s"] >= found["samples_per_s"]
    # There is no GPU to be busy.
    assert math.isnan(found["gpu_busy"])
    assert not list(tmp_path.iterdir())


def test_the_feed_has_not_ended_when_the_speed_is_measured(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead, left = BatchLoader.ahead, 0

    @contextmanager
    def watched(feed: BatchLoader, first: int, last: int) -> Iterator[Iterator[Batch]]:
        nonlocal left
        with ahead(feed, first, last) as batches:
            yield batches
            left = sum(1 for _ in batches)

    monkeypatch.setattr(BatchLoader, "ahead", watched)
    measure_training(config(data, tmp_path / "none"))
    # All but these are prepared, and the end of their processes takes a second.
    assert left > AHEAD


def weights(out: Path) -> dict[str, torch.Tensor]:
    return load_file(out / "weights.safetensors")


def state(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = torch.load(out / "checkpoint.pt", weights_only=True)
    return found


def assert_same_run(first: Path, second: Path) -> None:
    """Check that two runs came to the same weights, and judged them the same."""
    for name, value in weights(first).items():
        assert torch.equal(value, weights(second)[name]), name
    one, other = state(first), state(second)
    for part in ("model", "average"):
        for name, value in one["trainer"][part].items():
            assert torch.equal(value, other["trainer"][part][name]), (part, name)
    for moments, others in zip(
        one["trainer"]["optimizer"]["state"].values(),
        other["trainer"]["optimizer"]["state"].values(),
        strict=True,
    ):
        for name, value in moments.items():
            assert torch.equal(value, others[name]), name
    for name in ("history", "scores", "best_step", "samples"):
        assert one["so_far"][name] == other["so_far"][name]


def test_a_run_writes_what_it_did(data: Path, tmp_path: Path) -> None:
    report = train(config(data, tmp_path), command="lemma train tiny")
    assert report.status == "finished"
    assert report.steps == 24
    assert report.samples == 96
    assert report.samples_per_s > 0
    assert 0 < report.input_wait < 1
    assert report.parameters == sum(v.numel() for v in Tiny(TinyConfig()).parameters())
    assert [entry["step"] for entry in report.history] == [8, 16, 24]
    assert set(report.scores_by_kind) == {"high_level", "human"}
    best = max(report.history, key=lambda entry: entry["primitive"])
    assert report.best_step == best["step"]
    assert report.scores["primitive"] == best["primitive"]
    assert json.loads((tmp_path / "report.json").read_text()) == asdict(report)
    written = json.loads((tmp_path / "config.json").read_text())
    assert written["model_options"] == {"width": 8, "dropout": 0.1}
    assert (
        TrainingConfig.from_dict(written["training"])
        == config(data, tmp_path).resolved()
    )
    assert list((tmp_path / "tensorboard").glob("events.*"))


def test_training_lowers_the_loss(data: Path, tmp_path: Path) -> None:
    options = {"steps": 150, "val_every": 150, "episodes": 1, "ema": 0.5}
    calm = Augmentation.none()
    run = config(data, tmp_path, **options, augmentation=calm, train_split="val",
                 options=("dropout=0.0", "width=32"))  # fmt: skip
    report = train(run)
    assert report.passes == 200
    # One of four episodes is known by heart.
    assert report.scores["primitive"] > 0.6


def test_the_seed_decides(data: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(config(data, tmp_path / name, seed=seed, steps=8))
    assert_same_run(tmp_path / "a", tmp_path / "b")
    assert not torch.equal(
        weights(tmp_path / "a")["first.weight"], weights(tmp_path / "c")["first.weight"]
    )


@pytest.mark.parametrize("mixed", slow_but([False, True], True))
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(
    data: Path,
    recovery: Path,
    mixed: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    more = {"recovery": recovery, "recovery_share": 0.3} if mixed else {}
    train(config(data, tmp_path / "whole", **more))
    run = config(data, tmp_path / "parts", checkpoint_every_s=1e-9, **more)
    one_step = Trainer.train

    def stop_at_eleven(trainer: Trainer, *args: Any) -> Any:
        if trainer.step == 11:
            os.kill(os.getpid(), signal.SIGTERM)
        return one_step(trainer, *args)

    monkeypatch.setattr(Trainer, "train", stop_at_eleven)
    report = train(run)
    assert report.status == "interrupted"
    assert report.steps == 12
    monkeypatch.setattr(Trainer, "train", one_step)
    assert train(run).status == "finished"
    assert_same_run(tmp_path / "whole", tmp_path / "parts")


def finish(process: subprocess.Popen[str]) -> None:
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors


def start(
    data: Path, out: Path, *words: str, processes: int = 1
) -> subprocess.Popen[str]:
    """Start a run in a process of its own, or in several that torchrun starts."""
    launch = [sys.executable]
    if processes > 1:
        launch += ["-m", "torch.distributed.run", "--nproc-per-node", str(processes)]
        launch += ["--master-port", "0", "--rdzv-backend", "c10d"]
        launch += ["--rdzv-endpoint", "localhost:0"]
    command = [
        *launch,
        str(HERE.parents[1] / "support" / "tiny_model.py"),
        *(NAME, "--data", str(data), "--out", str(out)),
        *("--batch-size", "4", "--warmup-steps", "4", "--learning-rate", "1e-2"),
        *("--checkpoint-every-s", "1e-9"),
        *words,
    ]
    source = str(Path(loop.__file__).parents[3])
    environment = {**os.environ, "PYTHONPATH": source, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, cwd=out.parent
    )


@pytest.mark.slow
@pytest.mark.parametrize("mixed", [False, True])
def test_two_processes_do_what_one_does_with_twice_the_batch(
    data: Path, recovery: Path, mixed: bool, tmp_path: Path
) -> None:
    # Random draws belong to a process, so there are none.
    calm = Augmentation.none()
    options = ("dropout=0.0",)
    more = {"recovery": recovery, "recovery_share": 0.5} if mixed else {}
    train(config(data, tmp_path / "one", batch_size=8, steps=10, val_every=5,
                 augmentation=calm, options=options, **more))  # fmt: skip
    off = [f"--augmentation.no-{name}" for name in ("palette", "templates", "turn")]
    for name in ("paraphrases", "translate-cells", "brightness", "pixel-noise",
                 "height-noise-m", "dropouts"):  # fmt: skip
        off += [f"--augmentation.{name}", "0"]
    off += [
        word for n, v in more.items() for word in (f"--{n.replace('_', '-')}", str(v))
    ]
    words = ("--options", *options, "--steps", "10", "--val-every", "5", *off)
    finish(start(data, tmp_path / "two", *words, processes=2))
    one, two = state(tmp_path / "one")["trainer"], state(tmp_path / "two")["trainer"]
    for name, value in one["model"].items():
        if value.is_floating_point():
            assert torch.allclose(value, two["model"][name], atol=1e-5), name
    first, second = (
        json.loads((tmp_path / name / "report.json").read_text())
        for name in ("one", "two")
    )
    assert first["samples"] == second["samples"] == 80
    for name, score in first["scores"].items():
        assert score == pytest.approx(second["scores"][name], abs=1e-4)


def test_every_unit_is_drawn_once_in_each_pass() -> None:
    orders = [Sampler(14, 4, 3, rank, 2) for rank in (0, 1)]
    drawn = [unit for step in range(7) for o in orders for unit in o.step(step)]
    for start in range(0, 56, 14):
        assert sorted(drawn[start : start + 14]) == list(range(14))
    assert drawn[:14] != drawn[14:28]
    assert drawn[:8] == Sampler(14, 8, 3).step(0)
    assert Sampler(14, 8, 4).step(0) != drawn[:8]
    # A step is a function of its number, in whatever order steps are asked for.
    assert [Sampler(14, 8, 3).step(n) for n in (6, 0)] == [drawn[48:56], drawn[:8]]


def test_what_goes_wrong_in_the_feed_is_raised_in_the_loop(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(feed: BatchLoader, step: int, lesson: None) -> None:
        raise RuntimeError(f"no batch {step}")

    monkeypatch.setattr(BatchLoader, "make", fail)
    with pytest.raises(RuntimeError, match="no batch 0"):
        train(config(data, tmp_path))


def test_the_first_episodes_of_every_task_are_trained_on(
    data: Path, tmp_path: Path
) -> None:
    model = tiny_model.TinyEpisodes(tiny_model.TinyEpisodesConfig())
    frames = Frames.load(data)
    units = training_units(model, frames, config(data, tmp_path, episodes_per_task=2))
    every = sorted(set(frames.instances))
    assert sorted(frames.instances[unit[0]] for unit in units) == [
        found
        for task in sorted(set(frames.tasks))
        for found in [one for one in every if one[0] == task][:2]
    ]
    with pytest.raises(InvalidConfigError, match=r"--episodes-per-task is 900"):
        training_units(model, frames, config(data, tmp_path, episodes_per_task=900))
    with pytest.raises(InvalidConfigError, match="Leave out one"):
        config(data, tmp_path, episodes_per_task=1, episodes=1)


def test_whole_episodes_are_drawn_for_models_that_want_them(
    data: Path, tmp_path: Path
) -> None:
    model = tiny_model.TinyEpisodes(tiny_model.TinyEpisodesConfig())
    frames = Frames.load(data)
    units = training_units(model, frames, config(data, tmp_path, episodes=4))
    assert len(units) == 4
    assert all(len(unit) == 3 for unit in units)
    report = train(config(data, tmp_path, model=f"{NAME}-episodes", steps=4))
    assert report.samples == 4 * 4 * 3


def test_the_learning_rate_rises_and_falls(data: Path, tmp_path: Path) -> None:
    run = config(data, tmp_path, warmup_steps=10, learning_rate=1.0)
    rates = [learning_rate(run, step, step / 100) for step in range(101)]
    assert rates[0] == pytest.approx(0.1)
    assert max(rates) == rates[9] > 0.9
    assert rates[50] == pytest.approx(0.5)
    assert rates[100] == pytest.approx(0.0)


@pytest.mark.slow
def test_time_is_up(data: Path, tmp_path: Path) -> None:
    run = config(data, tmp_path, steps=100_000, val_every=100_000, time_limit_s=1.0)
    report = train(run)
    assert report.status == "time is up"
    assert 0 < report.steps < 100_000
    assert report.best_step == report.steps
    path = tmp_path / "weights.safetensors"
    ended = read_metadata(path)
    assert (ended.ended, ended.steps) == ("time limit", report.steps)
    assert train(run).steps == report.steps
    assert read_metadata(path) == ended


def test_weights_can_be_what_another_run_begins_with(
    data: Path, tmp_path: Path
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    train(config(data, first, options=("width=16",)))
    run = config(data, second, start=str(first), steps=1, learning_rate=1e-9)
    train(run)
    for name, value in weights(first).items():
        if value.is_floating_point():
            assert torch.allclose(value, weights(second)[name], atol=1e-3), name
    with pytest.raises(InvalidConfigError, match="Leave out --options"):
        train(replace(run, out=tmp_path / "third", options=("width=16",)))
    with pytest.raises(InvalidConfigError, match=f"not {NAME}-episodes"):
        train(replace(run, out=tmp_path / "fourth", model=f"{NAME}-episodes"))


def test_every_model_has_defaults_of_its_own() -> None:
    ours = [name for name in MODELS if not name.startswith(NAME)]
    assert sorted(ours) == sorted(DEFAULTS)
    for name in ours:
        kind, options = MODELS[name]
        assert decode(options, json.loads(json.dumps(asdict(options())))) == options()
        assert kind.unit in ("frame", "episode")
