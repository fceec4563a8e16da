"""Checkpoints of LeRobot in one file; `make test-lerobot` acts with one."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import publish_weights as publish
from lemma.core.errors import DatasetError, WeightsError
from lemma.core.files import sha256_of
from lemma.evaluation.records import training_seed
from lemma.evaluation.run.loading import weights_of
from lemma.policies import weights
from lemma.policies.control.checkpoint_file import (
    MODEL,
    checkpoint_folder,
    unpack_checkpoint,
)
from lemma.policies.spec import PolicySpec
from lemma.policies.weights import load_model
from lemma.policies.weights_file import (
    TIME_LIMIT,
    WeightsMetadata,
    read_metadata,
    write_weights,
)
from publish_weights import CONFIG, TRAINING, Fineness, pack_checkpoint

COMMAND = "lerobot-train --policy.type=act"
STATISTICS = "policy_preprocessor_step_3_normalizer_processor.safetensors"
STEPS, SEED = 3000, 7
COARSE = 64.0


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    """A small checkpoint as lerobot saves it."""
    folder = tmp_path / "runs/act/checkpoints" / f"{STEPS:06d}" / "pretrained_model"
    folder.mkdir(parents=True)
    torch.manual_seed(0)
    kernels = {"model.kernel": torch.randn(64, 64), "model.bias": torch.randn(64)}
    save_file({**kernels, "model.batches": torch.tensor(5)}, folder / MODEL)
    # In 16 bits they would not be these numbers any more.
    save_file({"action.mean": torch.tensor([0.12345678])}, folder / STATISTICS)
    config = {"type": "act", "device": "cuda", "pretrained_path": str(tmp_path)}
    training = {
        "seed": SEED,
        "steps": STEPS,
        "batch_size": 256,
        "dataset": {"repo_id": "lemma/control", "root": str(tmp_path)},
    }
    for name, content in ((CONFIG, config), (TRAINING, training)):
        (folder / name).write_text(json.dumps(content))
    (folder / "policy_preprocessor.json").write_text('{"steps": []}')
    return folder


@pytest.fixture
def published(
    tmp_path: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A checkout where it is published as ``moves``."""
    folder = tmp_path / "weights"
    monkeypatch.setattr(weights, "CHECKOUT", folder)
    fineness = Fineness(COARSE, small=0)
    return publish.pack(checkpoint, "moves", fineness, folder, COMMAND)


def test_what_is_unpacked_is_the_checkpoint(
    tmp_path: Path, checkpoint: Path, published: Path
) -> None:
    folder = tmp_path / "unpacked"
    folder.mkdir()
    unpack_checkpoint(published, folder)
    names = {path.name for path in checkpoint.iterdir()} - {TRAINING}
    assert {path.name for path in folder.iterdir()} == names
    for name in names - {MODEL, CONFIG}:
        assert (folder / name).read_bytes() == (checkpoint / name).read_bytes()
    found, given = load_file(folder / MODEL), load_file(checkpoint / MODEL)
    assert found.keys() == given.keys()
    assert torch.equal(found["model.batches"], given["model.batches"])
    assert found["model.kernel"].dtype == torch.float32
    kernel = given["model.kernel"]
    # Half a step, after half of the last of eleven bits.
    most = 0.5 * kernel.std() / COARSE + 2.0**-11 * kernel.abs().max()
    assert (found["model.kernel"] - kernel).abs().max() <= most
    assert torch.equal(found["model.bias"], given["model.bias"].half().float())


def test_it_says_what_trained_it_and_not_where(tmp_path: Path, published: Path) -> None:
    about = read_metadata(published)
    assert (about.model, about.command) == ("lerobot:act", COMMAND)
    assert (about.ended, about.steps) == ("steps", STEPS)
    assert str(tmp_path).encode() not in published.read_bytes()


def test_a_training_that_was_cut_short_is_told_of(
    tmp_path: Path, checkpoint: Path
) -> None:
    training = json.loads((checkpoint / TRAINING).read_text()) | {"steps": STEPS + 1}
    (checkpoint / TRAINING).write_text(json.dumps(training))
    path = tmp_path / "weights.safetensors"
    pack_checkpoint(checkpoint, path, COMMAND, Fineness(COARSE))
    assert (read_metadata(path).ended, read_metadata(path).steps) == (TIME_LIMIT, STEPS)


def test_it_is_found_by_its_name(published: Path) -> None:
    with checkpoint_folder("moves") as folder:
        assert (Path(folder) / MODEL).is_file()
    assert not Path(folder).exists()
    with checkpoint_folder("somebody/else") as folder:
        assert folder == "somebody/else"
    with (
        pytest.raises(WeightsError, match=r"no checkpoint runs/act/nowhere.*: moves\."),
        checkpoint_folder("runs/act/nowhere"),
    ):
        pass
    told = weights_of(PolicySpec("lerobot:moves"))["act"]
    listed = weights.published_weights()["moves"]
    assert (told["sha256"], told["seed"]) == (listed["sha256"], SEED)


def test_a_full_disk_is_no_damage(
    tmp_path: Path, published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with (
        pytest.raises(WeightsError, match=r"No such file.*Free some space.*TMPDIR"),
        checkpoint_folder("moves"),
    ):
        pass
    with pytest.raises(WeightsError, match="Free some space"):
        unpack_checkpoint(published, tmp_path / "nowhere")


def test_a_checkpoint_may_not_say_what_trained_it(checkpoint: Path) -> None:
    """As ``save_pretrained`` writes it, without ``train_config.json``."""
    policy = PolicySpec(f"lerobot:{checkpoint}")
    assert weights_of(policy)["act"]["seed"] == SEED
    (checkpoint / TRAINING).unlink()
    told = weights_of(policy)
    assert told == {"act": {"sha256": sha256_of(checkpoint / MODEL)}}
    assert training_seed(told) == 0
    (checkpoint / CONFIG).write_text('{"device": "cpu"}')
    with pytest.raises(WeightsError, match=r"no whole checkpoint of LeRobot.*'type'"):
        weights_of(policy)
    (checkpoint / CONFIG).unlink()
    with pytest.raises(WeightsError, match=r"no whole checkpoint of LeRobot"):
        weights_of(policy)


def test_other_kinds_of_weights_are_told_apart(tmp_path: Path, published: Path) -> None:
    with pytest.raises(WeightsError, match="Put 'lerobot:' before its name"):
        load_model("moves")
    other = tmp_path / "weights.safetensors"
    write_weights(other, {"a": torch.zeros(2)}, WeightsMetadata("reachnet", {}))
    with pytest.raises(WeightsError, match="Leave out 'lerobot:'"):
        unpack_checkpoint(other, tmp_path)


@pytest.mark.parametrize("name", ["../evil.json", "/tmp/evil.json", "evil.py", ""])
def test_it_writes_into_its_folder_alone(tmp_path: Path, name: str) -> None:
    path = tmp_path / "weights.safetensors"
    evil = {f"file:{name}": torch.zeros(3, dtype=torch.uint8)}
    write_weights(path, evil, WeightsMetadata("lerobot:act", {}))
    folder = tmp_path / "inner/folder"
    folder.mkdir(parents=True)
    with pytest.raises(WeightsError, match="is no file of a checkpoint"):
        unpack_checkpoint(path, folder)
    assert not [*tmp_path.rglob("evil*")]


def test_damaged_files_are_refused(tmp_path: Path, published: Path) -> None:
    content = published.read_bytes()
    published.write_bytes(content[: len(content) // 2])
    with pytest.raises(WeightsError, match="damaged"):
        unpack_checkpoint(published, tmp_path)


def test_nobody_publishes_what_nobody_says_how_to_make(
    tmp_path: Path, checkpoint: Path
) -> None:
    with pytest.raises(WeightsError, match="--command"):
        publish.pack(checkpoint, "moves", Fineness(COARSE), tmp_path)
    with pytest.raises(DatasetError):
        pack_checkpoint(tmp_path, tmp_path / "a", COMMAND, Fineness(COARSE))


def test_a_folder_that_was_moved_says_no_steps(
    tmp_path: Path, checkpoint: Path
) -> None:
    moved = checkpoint.rename(tmp_path / "mine")
    with pytest.raises(WeightsError, match="lacks the number of steps"):
        pack_checkpoint(moved, tmp_path / "a", COMMAND, Fineness(COARSE))
