"""Weights by name: where they are found, fetched from, and how they are published."""

import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import tiny_model
import tyro
from command import run
from fake_hub import COMMIT, FakeHub, taken_for_the_hub
from tiny_model import ABOUT, Tiny, written

import publish_weights as publish
from lemma.core.errors import UnknownNameError, WeightsError
from lemma.core.files import read_json, write_json
from lemma.policies import weights
from lemma.policies.class_path import LEROBOT
from lemma.policies.training.config import TrainingConfig
from lemma.policies.weights import (
    CHECKOUT,
    FOLDER_VARIABLE,
    LIST,
    find_weights,
    load_model,
    published_weights,
)
from lemma.policies.weights_file import (
    read_metadata,
)
from publish_weights import Fineness

tiny_model.register()
hub = pytest.fixture(taken_for_the_hub)


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with published weights, named small."""
    folder = tmp_path / "checkout"
    about = replace(ABOUT, ended="time limit", steps=5)
    publish.pack(written(tmp_path, about), "small", Fineness(32), folder)
    monkeypatch.setattr(weights, "CHECKOUT", folder)
    monkeypatch.delenv(FOLDER_VARIABLE, raising=False)
    return folder


def published_on(hub: FakeHub, checkout: Path) -> Path:
    """Move the file of a checkout to the hub; return where it was."""
    path = checkout / "small.safetensors"
    hub.exists = True
    hub.files[path.name] = path.read_bytes()
    path.unlink()
    entry = read_json(checkout / LIST)["small"]
    pinned = {**entry, "repository": "org/weights", "revision": COMMIT}
    write_json(checkout / LIST, {"small": pinned})
    return path


def test_published_weights_are_found_in_a_checkout_and_checked(checkout: Path) -> None:
    path = checkout / "small.safetensors"
    assert find_weights("small") == path
    entry = published_weights()["small"]
    assert entry["command"] == ABOUT.command
    assert (entry["ended"], entry["steps"]) == ("time limit", 5)
    assert (entry["data"], entry["bytes"]) == (ABOUT.data, path.stat().st_size)
    with pytest.raises(UnknownNameError, match="Did you mean 'small'"):
        find_weights("snall")
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(WeightsError, match="checksum differs"):
        find_weights("small")


def test_a_folder_of_the_users_comes_first(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setenv(FOLDER_VARIABLE, str(own))
    assert find_weights("small") == checkout / "small.safetensors"
    (checkout / "small.safetensors").rename(own / "small.safetensors")
    assert find_weights("small") == own / "small.safetensors"


def test_what_is_nowhere_says_where_it_can_be_had(checkout: Path) -> None:
    (checkout / "small.safetensors").unlink()
    with pytest.raises(
        WeightsError, match=f"{FOLDER_VARIABLE}=FOLDER.*{ABOUT.command}"
    ):
        find_weights("small")


def test_published_weights_are_fetched_by_revision(
    checkout: Path, hub: FakeHub, capsys: pytest.CaptureFixture[str]
) -> None:
    published_on(hub, checkout)
    assert run("pull", "--weights", "small") == 0
    assert "small: " in capsys.readouterr().out
    asked = [request for request in hub.requests if "/resolve/" in request]
    assert asked
    assert all(f"/resolve/{COMMIT}/small.safetensors" in one for one in asked)
    fetched = find_weights("small")
    assert isinstance(load_model("small"), Tiny)
    # Without a network, what was fetched before is there.
    hub.status = 503
    assert find_weights("small") == fetched


def test_a_file_that_arrives_damaged_is_fetched_again(
    checkout: Path, hub: FakeHub
) -> None:
    path = published_on(hub, checkout)
    hub.damaged = {path.name: 1}
    assert isinstance(load_model("small"), Tiny)
    hub.damaged = {path.name: 2}
    find_weights("small").write_bytes(b"damaged")
    with pytest.raises(WeightsError, match="checksum differs"):
        find_weights("small")


def test_without_a_hub_the_command_is_named(
    checkout: Path, hub: FakeHub, capsys: pytest.CaptureFixture[str]
) -> None:
    published_on(hub, checkout)
    hub.exists = False
    with pytest.raises(WeightsError, match="lemma pull --weights small"):
        find_weights("small")
    assert run("pull", "--weights", "smal") == 2
    assert "Did you mean 'small'" in capsys.readouterr().err


def test_models_load_from_the_hub(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, asked = written(tmp_path), []

    def download(repository: str, file: str, **_: Any) -> str:
        asked.append((repository, file))
        if repository == "org/missing":
            raise OSError("404: no such repository\nand a long page")
        if repository == "org/token":
            "hf_ours\N{RIGHT DOUBLE QUOTATION MARK}".encode("ascii")
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
    with pytest.raises(WeightsError, match="Set HF_TOKEN again") as caught:
        load_model("org/token")
    assert "hf_ours" not in str(caught.value)

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(weights, "import_module", missing)
    with pytest.raises(WeightsError, match=r"lemma-bench\[hub\]"):
        load_model("org/name")


def test_weights_that_are_too_large_are_not_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publish, "LARGEST_MB", 0.001)
    with pytest.raises(WeightsError, match="train a smaller model"):
        publish.pack(written(tmp_path), "small", Fineness(32), tmp_path / "shelf")
    assert not list((tmp_path / "shelf").iterdir())


@pytest.mark.parametrize("name", list(published_weights()))
def test_the_list_and_the_command_are_what_the_metadata_say(name: str) -> None:
    entry, metadata = published_weights()[name], read_metadata(find_weights(name))
    for part in ("model", "data", "command", "ended", "steps", "scores", "lemma"):
        assert entry[part] == getattr(metadata, part), part
    first, *lessons = metadata.command.split("; ")
    words = shlex.split(first)
    for lesson in lessons:
        python, script, *_ = lesson.split()
        assert python == "python"
        assert (CHECKOUT.parent / script).is_file()
    if metadata.model.startswith(LEROBOT):
        assert words[:2] == ["python", "scripts/control_baselines.py"]
        return
    assert words[:2] == ["lemma", "train"]
    typed = tyro.cli(TrainingConfig, args=words[2:])
    # This command trains with these very options.
    made = TrainingConfig.from_dict(metadata.training)
    # Compiled or not: by default a GPU compiles since they were trained.
    assert replace(typed.resolved(), compile=made.compile) == made
    if entry["ended"] == "steps":
        assert entry["steps"] == made.steps
    if entry["ended"] == "time limit":
        assert made.time_limit_s is not None


def test_the_checkout_has_the_files_of_its_list() -> None:
    files = {path.name for path in CHECKOUT.glob("*.safetensors")}
    assert files == {entry["file"] for entry in published_weights().values()}
