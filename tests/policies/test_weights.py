import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import tiny_model
import torch
from safetensors.torch import load_file, save_file
from tiny_model import ABOUT, Tiny, TinyConfig, tiny, written

import publish_weights as publish
from lemma.core.errors import DatasetError, WeightsError
from lemma.policies import weights_file
from lemma.policies.models.catalog import MODELS
from lemma.policies.training.step import read_state, write_state
from lemma.policies.weights import load_model
from lemma.policies.weights_file import (
    METADATA_KEY,
    Rounding,
    load_weights,
    mark_ended,
    read_metadata,
    unpack,
    write_weights,
)

tiny_model.register()


def test_weights_come_back_with_their_model(tmp_path: Path) -> None:
    path = written(tmp_path)
    model = load_weights(path)
    assert isinstance(model, Tiny)
    assert model.config == TinyConfig(width=12, dropout=0.25)
    assert not model.training
    assert read_metadata(path) == ABOUT
    for name, value in tiny().state_dict().items():
        found = model.state_dict()[name]
        assert found.dtype == value.dtype
        assert torch.allclose(found, value, atol=1e-3)
    assert load_file(path)["first.weight"].dtype == torch.float16
    # Others than who trained them may read them.
    assert path.stat().st_mode & 0o044 == 0o044


def test_weights_too_large_for_16_bits_are_not_written(tmp_path: Path) -> None:
    model = tiny()
    with torch.no_grad():
        model.first.weight[0, 0] = 1e6
    with pytest.raises(WeightsError, match=r"'first.weight' is not finite"):
        write_weights(tmp_path / "w.safetensors", model.state_dict(), ABOUT)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path)
    before = path.read_bytes()

    def fail(tensors: object, draft: Path, metadata: object) -> None:
        draft.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(weights_file, "save_file", fail)
    with pytest.raises(DatasetError, match="disk is full"):
        written(tmp_path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_damaged_weights_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(WeightsError, match="is damaged"):
        load_weights(path)
    with pytest.raises(WeightsError, match="There is no file"):
        load_weights(tmp_path / "other.safetensors")
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(WeightsError, match="does not say which model"):
        load_weights(path)


def test_weights_of_another_shape_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, replace(ABOUT, options={"width": 13, "dropout": 0.0}))
    with pytest.raises(WeightsError, match=r"first.weight is \(12, 17\) instead of"):
        load_weights(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"model": "tiniest"}, "Unknown model 'tiniest'"),
        ({"options": {"depth": 3}}, "Unknown option of TinyConfig 'depth'"),
        ({"options": {"widht": 3}}, "Did you mean 'width'"),
        ({"version": "1"}, "version 1 of the format"),
    ],
)
def test_weights_of_another_version_are_refused(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    path = written(tmp_path, replace(ABOUT, **change))  # type: ignore[arg-type]
    with pytest.raises(WeightsError, match=words):
        load_weights(path)


def test_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    write_state(tmp_path / "good.pt", {"a": torch.ones(2), "b": [1, "x", {"c": 0.5}]})
    state = read_state(tmp_path / "good.pt", torch.device("cpu"))
    assert state["b"] == [1, "x", {"c": 0.5}]
    torch.save({"path": SimpleNamespace()}, tmp_path / "bad.pt")
    with pytest.raises(WeightsError, match="--restart"):
        read_state(tmp_path / "bad.pt", torch.device("cpu"))


def test_models_load_from_files_and_folders(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert isinstance(load_model(str(path)), Tiny)
    assert isinstance(load_model(str(tmp_path)), Tiny)
    with pytest.raises(WeightsError, match="There is no file"):
        load_model(str(tmp_path / "none.safetensors"))


def test_how_a_run_ended_is_written_beside_its_weights(tmp_path: Path) -> None:
    path = written(tmp_path)
    before = load_file(path)
    assert read_metadata(path).ended == ""
    mark_ended(path, "time limit", 7)
    assert read_metadata(path) == replace(ABOUT, ended="time limit", steps=7)
    for name, value in load_file(path).items():
        assert torch.equal(value, before[name])


def hostile(folder: Path, metadata: Any, **tensors: torch.Tensor) -> Path:
    """Write a file of weights that nothing of ours would write."""
    path = folder / "hostile.safetensors"
    text = metadata if isinstance(metadata, str) else json.dumps(metadata)
    own = {name: value.half() for name, value in tiny().state_dict().items()}
    save_file({**own, "seen": torch.zeros((), dtype=torch.int64), **tensors}, path,
              {METADATA_KEY: text})  # fmt: skip
    return path


PLAIN = asdict(ABOUT)


@pytest.mark.parametrize(
    "metadata",
    [
        "no JSON",
        "[" * 100_000,
        '{"model": ' * 100_000,
        "[]",
        "null",
        "{}",
        json.dumps({**PLAIN, "model": 3}),
        json.dumps({**PLAIN, "options": [1]}),
        json.dumps({**PLAIN, "options": {"width": "12"}}),
        json.dumps({**PLAIN, "options": {"width": 1.5}}),
        json.dumps({**PLAIN, "options": {"width": True}}),
        json.dumps({**PLAIN, "options": {"width": {"a": 1}}}),
        json.dumps({**PLAIN, "options": {"width": 10**12}}),
        json.dumps({**PLAIN, "options": {"width": -1}}),
        '{"model": "tiny", "options": {"dropout": NaN}}',
        json.dumps({**PLAIN, "ended": "well"}),
        json.dumps({**PLAIN, "packed": {"first.weight": {"shape": [12, 17]}}}),
        json.dumps({**PLAIN, "scores": {"a": 0.5}, "command": "x" * 2**21}),
    ],
    ids=lambda text: str(text)[:40],
)
def test_hostile_metadata_are_refused(tmp_path: Path, metadata: str) -> None:
    with pytest.raises(WeightsError):
        load_weights(hostile(tmp_path, metadata))


@pytest.mark.parametrize(
    ("tensors", "words"),
    [
        ({"first.weight": torch.full((12, 17), torch.nan)}, "is not finite"),
        ({"first.weight": torch.zeros(12, 17, dtype=torch.int64)}, "torch.int64"),
        ({"seen": torch.zeros(())}, "where torch.int64 is meant"),
        ({"first.weight": torch.zeros(12, 18)}, r"\(12, 18\) instead of"),
        ({"more": torch.zeros(1)}, "more is not known"),
    ],
)
def test_hostile_tensors_are_refused(
    tmp_path: Path, tensors: dict[str, torch.Tensor], words: str
) -> None:
    with pytest.raises(WeightsError, match=words):
        load_weights(hostile(tmp_path, PLAIN, **tensors))


@pytest.mark.parametrize("name", ["cliport", "m-cliport", "episodic-transformer"])
def test_sizes_that_no_file_holds_take_no_memory(tmp_path: Path, name: str) -> None:
    """Options within their ranges may still ask for more than any machine has."""
    _, kind = MODELS[name]
    large = {
        option: [4096] * len(value) if isinstance(value, tuple) else value
        for option, value in asdict(kind()).items()
    }
    with pytest.raises(WeightsError, match=r"is missing|instead of"):
        load_weights(hostile(tmp_path, {**PLAIN, "model": name, "options": large}))


def test_layers_that_no_file_holds_are_refused(tmp_path: Path) -> None:
    for layers, words in ((64, "is missing"), (65, "<= 64")):
        options = {"planner": {"layers": layers}, "reader": {"layers": layers}}
        about = {**PLAIN, "model": "reachnet", "options": options}
        with pytest.raises(WeightsError, match=words):
            load_weights(hostile(tmp_path, about))


def test_heads_that_cannot_share_a_width_are_refused(tmp_path: Path) -> None:
    # All tensors have the shapes that they would have with other heads.
    for name, options in (
        ("episodic-transformer", {"heads": 7}),
        ("reachnet", {"planner": {"heads": 3}}),
    ):
        about = {**PLAIN, "model": name, "options": options}
        with pytest.raises(WeightsError, match="heads cannot share a width"):
            load_weights(hostile(tmp_path, about))


def test_packed_weights_are_within_half_a_step(tmp_path: Path) -> None:
    torch.manual_seed(3)
    given = {
        "large": torch.randn(256, 256),
        "small": torch.randn(64, 32) * 1e-3,
        "outlier": torch.cat([torch.randn(200_000), torch.tensor([4e3])])[None],
        "vector": torch.randn(4096),
        "zeros": torch.zeros(64, 64),
        "count": torch.tensor([3]),
    }
    tensors, roundings = publish.rounded(given, publish.Fineness(32))
    assert set(roundings) == {"large", "small", "outlier"}
    for name, rounding in roundings.items():
        found = unpack(tensors[name], rounding)
        assert found.shape == given[name].shape
        assert (found - given[name]).abs().max() <= 0.5001 * rounding.step
    assert roundings["small"].step < 3e-6
    assert torch.equal(tensors["vector"], given["vector"].half())
    assert torch.equal(tensors["zeros"], given["zeros"].half())
    assert torch.equal(tensors["count"], given["count"])
    # A normal distribution in 32 steps has an entropy of 7.05 bits.
    assert 7.0 < 8 * tensors["large"].numel() / 256**2 < 7.2


def test_a_packed_file_is_a_file_of_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publish, "_LEAST", 100)
    path = tmp_path / "packed.safetensors"
    publish.write_packed(path, tiny().state_dict(), ABOUT, publish.Fineness(32))
    assert set(read_metadata(path).packed) == {"first.weight"}
    found = load_weights(path).state_dict()
    for name, value in tiny().state_dict().items():
        assert torch.allclose(found[name], value, atol=1e-3)


@pytest.mark.parametrize(
    "coded",
    [
        b"",
        b"nothing of the sort",
        publish._coded(torch.zeros(10**6, dtype=torch.int32).numpy()),
        publish._coded(torch.zeros(11, dtype=torch.int32).numpy()),
        publish._coded(torch.zeros(12, dtype=torch.int32).numpy())[:-9],
    ],
)
def test_codes_of_something_else_are_refused(coded: bytes) -> None:
    tensor = torch.tensor(list(coded), dtype=torch.uint8)
    with pytest.raises(ValueError, match=r"values or more|Error -|incorrect"):
        unpack(tensor, Rounding((3, 4), 0.5))
    with pytest.raises(ValueError, match="is no code"):
        unpack(torch.zeros(3, 4), Rounding((3, 4), 0.5))
    for step in (float("nan"), float("inf"), 1e308, 1e35, -1.0):
        with pytest.raises(ValueError, match="a step of"):
            unpack(tensor, Rounding((3, 4), step))
