import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest
import tiny_model
import torch
from command import run as run_lemma
from painted_keyframes import painted, write_painted  # noqa: F401 - fixtures
from tiny_model import NAME, Tiny, config

from lemma.cli.main import main
from lemma.core.errors import (
    DatasetError,
    InvalidConfigError,
    UnknownNameError,
    WeightsError,
)
from lemma.dataset.files import MANIFEST
from lemma.policies.training.config import Augmentation, model_options
from lemma.policies.training.distributed import processes
from lemma.policies.training.loop import TrainingError, train
from lemma.policies.training.run import TrainingReport
from lemma.tasks.instance import BENCHMARK_VERSION

tiny_model.register()


def test_another_run_in_the_folder_is_not_overwritten(
    data: Path, tmp_path: Path
) -> None:
    train(config(data, tmp_path, steps=2))
    kept = (tmp_path / "weights.safetensors").read_bytes()
    with pytest.raises(DatasetError, match=r"seed was 0 and is now 1.*--restart"):
        train(config(data, tmp_path, steps=2, seed=1))
    with pytest.raises(DatasetError, match="width was 8 and is now 9"):
        train(config(data, tmp_path, steps=2, options=("width=9",)))
    assert (tmp_path / "weights.safetensors").read_bytes() == kept
    report: TrainingReport = train(
        config(data, tmp_path, steps=2, seed=1), restart=True
    )
    assert report.steps == 2
    assert (tmp_path / "weights.safetensors").read_bytes() != kept


def test_options_of_the_model_are_checked(data: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'width'"):
        train(config(data, tmp_path, options=("widthh=3",)))
    with pytest.raises(InvalidConfigError, match="NAME=VALUE"):
        train(config(data, tmp_path, options=("width",)))
    with pytest.raises(InvalidConfigError, match=r"Expected `int`, got `str`.*width"):
        train(config(data, tmp_path, options=("width=wide",)))
    with pytest.raises(InvalidConfigError, match="conflicts with another"):
        train(config(data, tmp_path, options=("width=4", "width.deep=3")))
    with pytest.raises(UnknownNameError, match="Unknown model 'tinny'"):
        train(config(data, tmp_path, model="tinny"))
    assert model_options(("width=4", "dropout=0.5")) == {
        "width": 4,
        "dropout": 0.5,
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"steps": 0}, "steps cannot be 0; expected int >= 1"),
        ({"learning_rate": 0.0}, "expected float > 0"),
        ({"samples": 5}, "both set the length"),
        ({"ema": 1.0}, "ema cannot be 1.0; expected float < 1"),
        ({"kinds": ("unseen",)}, r"\('unseen',\); valid: high_level, human"),
        ({"kinds": ()}, "high_level, human"),
        ({"episodes": 99}, "has 10"),
        ({"device": "cuda"}, "No GPU"),
        (
            {"augmentation": Augmentation(dropouts=-1)},
            r"augmentation\.dropouts .* int >= 0",
        ),
        (
            {"augmentation": Augmentation(brightness=1.0)},
            r"augmentation\.brightness .* < 1",
        ),
        (
            {"augmentation": Augmentation(rotate_deg=math.nan)},
            r"augmentation\.rotate_deg .*nan",
        ),
    ],
)
def test_impossible_options_are_refused_with_a_remedy(
    data: Path, tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    if options.get("device") == "cuda" and torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(InvalidConfigError, match=words):
        train(config(data, tmp_path, **options))


def test_missing_or_foreign_data_are_refused_with_a_remedy(
    data: Path, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="lemma render RECIPE"):
        train(config(tmp_path / "nothing", tmp_path / "out"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="it has no rendered data"):
        train(config(tmp_path / "empty", tmp_path / "out"))
    old = write_painted(tmp_path / "old", {"train": 1, "val": 1})
    text = (old / MANIFEST).read_text()
    mine = f'"benchmark": "{BENCHMARK_VERSION}"'
    assert mine in text
    (old / MANIFEST).write_text(text.replace(mine, '"benchmark": "0"'))
    with pytest.raises(DatasetError, match="version 0 of the benchmark"):
        train(config(old, tmp_path / "out"))


def test_other_data_cannot_continue_a_run(data: Path, tmp_path: Path) -> None:
    train(config(data, tmp_path / "out", steps=2))
    other = write_painted(tmp_path / "other", {"train": 9, "val": 4})
    with pytest.raises(DatasetError, match="digest was"):
        train(config(other, tmp_path / "out", steps=2))


def test_a_damaged_checkpoint_is_refused_with_a_remedy(
    data: Path, tmp_path: Path
) -> None:
    train(config(data, tmp_path, steps=2))
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(WeightsError, match="--restart"):
        train(config(data, tmp_path, steps=2))


def test_a_loss_that_is_infinite_ends_the_run(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Tiny.loss

    def explode(model: Tiny, batch: Any) -> dict[str, torch.Tensor]:
        terms = plain(model, batch)
        return {name: term * torch.inf for name, term in terms.items()}

    monkeypatch.setattr(Tiny, "loss", explode)
    with pytest.raises(TrainingError, match="lower --learning-rate"):
        train(config(data, tmp_path, steps=3))
    assert not (tmp_path / "checkpoint.pt").exists()


def test_too_little_gpu_memory_names_a_smaller_batch(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run_out(model: Tiny, batch: Any) -> None:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory.")

    monkeypatch.setattr(Tiny, "loss", run_out)
    with pytest.raises(TrainingError, match="Try --batch-size 2"):
        train(config(data, tmp_path))


def test_the_command_is_kept_as_it_was_typed(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = f"lemma train {NAME} --data {data} --out {tmp_path} --steps 2"
    monkeypatch.setattr(sys, "argv", command.split())
    with pytest.raises(SystemExit):
        main()
    report = json.loads((tmp_path / "report.json").read_text("utf-8"))
    assert report["command"] == command


def test_the_command_trains_and_reports(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("train", NAME, "--data", data, "--out", tmp_path, "--steps", 3)
    assert run_lemma(*words, "--batch-size", 2, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["steps"] == 3
    assert run_lemma(*words, "--batch-size", 2) == 0
    assert "weights.safetensors" in capsys.readouterr().out
    assert run_lemma(*words, "--batch-size", 3) == 2
    assert "batch_size was 2 and is now 3" in capsys.readouterr().err


def test_the_command_says_what_is_missing_without_torch(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "lemma.policies.training.loop")
    assert run_lemma("train", NAME, "--data", data, "--out", tmp_path) == 2
    assert "lemma-bench[learn]" in capsys.readouterr().err


ENDPOINT = {"LOCAL_RANK": "0", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": "29500"}


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"WORLD_SIZE": "2"}, "RANK, LOCAL_RANK, MASTER_ADDR, MASTER_PORT missing"),
        ({"WORLD_SIZE": "2", **ENDPOINT}, "with RANK missing"),
        ({"WORLD_SIZE": "2", **ENDPOINT, "RANK": "2"}, "RANK too large"),
        ({"WORLD_SIZE": "2", **ENDPOINT, "RANK": "first"}, "RANK is 'first'"),
        ({"WORLD_SIZE": "2", **ENDPOINT, "RANK": "1", "MASTER_PORT": "x"}, "PORT is"),
        ({"WORLD_SIZE": "all"}, "WORLD_SIZE is 'all'"),
        ({"WORLD_SIZE": "0"}, "WORLD_SIZE is '0'"),
        ({"WORLD_SIZE": "-1"}, "WORLD_SIZE is '-1'"),
    ],
)
def test_processes_that_cannot_find_each_other_are_told_so(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], words: str
) -> None:
    for name in ("WORLD_SIZE", "RANK", *ENDPOINT):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InvalidConfigError, match=words), processes("cpu"):
        pass


@pytest.mark.parametrize("size", ["", " ", "1"])
def test_a_variable_that_is_empty_says_nothing(
    monkeypatch: pytest.MonkeyPatch, size: str
) -> None:
    monkeypatch.setenv("WORLD_SIZE", size)
    with processes("cpu") as group:
        assert (group.rank, group.count) == (0, 1)
