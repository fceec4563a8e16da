import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import tiny_model
import torch
from safetensors.torch import load_file, save_file
from tiny_model import NAME, Tiny, TinyConfig

from lemma.core.errors import DatasetError, UnknownNameError
from lemma.policies import checkpoints, weights
from lemma.policies.checkpoints import (
    About,
    WeightsError,
    load_weights,
    read_about,
    read_state,
    write_state,
    write_weights,
)
from lemma.policies.weights import (
    LIST,
    SHIPPED,
    find_weights,
    load_model,
    ship,
    shipped_weights,
)

tiny_model.register()

ABOUT = About(
    model=NAME,
    options={"width": 12, "dropout": 0.25},
    data={"benchmark": "v1", "digest": "d"},
    command="lemma train tiny --data d --out o",
    scores={"primitive": 0.5},
    lemma="0.1.0",
)


def tiny(seed: int = 0) -> Tiny:
    torch.manual_seed(seed)
    return Tiny(TinyConfig(width=12, dropout=0.25))


def written(folder: Path, about: About = ABOUT) -> Path:
    path = folder / "weights.safetensors"
    write_weights(path, tiny().state_dict(), about)
    return path


def test_weights_come_back_with_their_model(tmp_path: Path) -> None:
    path = written(tmp_path)
    model = load_weights(path)
    assert isinstance(model, Tiny)
    assert model.config == TinyConfig(width=12, dropout=0.25)
    assert not model.training
    assert read_about(path) == ABOUT
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

    monkeypatch.setattr(checkpoints, "save_file", fail)
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
        ({"version": "0"}, "version 0 of the format"),
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


def test_shipped_weights_are_found_by_name_and_checked(tmp_path: Path) -> None:
    run, shelf = tmp_path / "run", tmp_path / "shelf"
    run.mkdir()
    written(run)
    path = ship(run, "small", shelf)
    assert path == shelf / "small.safetensors"
    assert find_weights("small", shelf) == path
    entry = shipped_weights(shelf)["small"]
    assert entry["command"] == ABOUT.command
    assert entry["data"] == ABOUT.data
    assert entry["scores"] == ABOUT.scores
    assert len(entry["sha256"]) == 64
    with pytest.raises(UnknownNameError, match="Did you mean 'small'"):
        find_weights("snall", shelf)
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(WeightsError, match="checksum differs"):
        find_weights("small", shelf)
    path.unlink()
    with pytest.raises(WeightsError, match=f"train them: {ABOUT.command}"):
        find_weights("small", shelf)


def test_weights_that_are_too_large_do_not_ship(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path)
    monkeypatch.setattr(weights, "LARGEST_MB", 0.001)
    with pytest.raises(WeightsError, match="Train a smaller model"):
        ship(tmp_path, "small", tmp_path / "shelf")


def test_models_load_from_files_and_folders(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert isinstance(load_model(str(path)), Tiny)
    assert isinstance(load_model(str(tmp_path)), Tiny)
    with pytest.raises(WeightsError, match="There is no file"):
        load_model(str(tmp_path / "none.safetensors"))


def test_models_load_from_the_hub(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, asked = written(tmp_path), []

    def download(repository: str, file: str) -> str:
        asked.append((repository, file))
        if repository == "org/missing":
            raise OSError("404: no such repository\nand a long page")
        return str(path)

    def find(name: str) -> SimpleNamespace:
        assert name == "huggingface_hub"
        return SimpleNamespace(hf_hub_download=download)

    monkeypatch.setattr(weights, "import_module", find)
    assert isinstance(load_model("org/name"), Tiny)
    assert isinstance(load_model("org/name/seeds/1.safetensors"), Tiny)
    assert asked == [
        ("org/name", "weights.safetensors"),
        ("org/name", "seeds/1.safetensors"),
    ]
    with pytest.raises(WeightsError, match="404: no such repository"):
        load_model("org/missing")

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(weights, "import_module", missing)
    with pytest.raises(WeightsError, match=r"lemma-bench\[hub\]"):
        load_model("org/name")


def test_what_ships_is_what_the_list_says() -> None:
    listed = shipped_weights()
    files = {path.name for path in SHIPPED.glob("*.safetensors")}
    assert files <= {entry["file"] for entry in listed.values()}
    for name, entry in listed.items():
        if entry["file"] in files:
            assert read_about(find_weights(name)).model == entry["model"]
    if listed:
        text = (SHIPPED / LIST).read_text()
        assert json.loads(text) == listed
