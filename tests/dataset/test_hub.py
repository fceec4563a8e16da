"""Up to a hub and down again, with the real client and a hub of our own."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command import run
from fake_hub import FakeHub, point_at, taken_for_the_hub
from recipes import bytes_of, made_up, write_recipe

from lemma.core.errors import DatasetError
from lemma.dataset.files import MANIFEST, check_files
from lemma.dataset.hub import pull, push
from lemma.dataset.recipe.files import load

NAME = "me/data"
hub = pytest.fixture(taken_for_the_hub)

# The client's, not ours.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """A recipe of two splits."""
    folder = tmp_path / "recipe"
    manifests = []
    for task, split in (("stack", "val"), ("pass", "test")):
        write_recipe(folder, [made_up(task, split, i) for i in range(3)])
        manifests.append(json.loads((folder / MANIFEST).read_text()))
    files = {**manifests[0]["files"], **manifests[1]["files"]}
    (folder / MANIFEST).write_text(json.dumps({**manifests[0], "files": files}))
    (folder / "README.md").write_text("---\nlicense: apache-2.0\n---\nA recipe.\n")
    check_files(folder)
    return folder


@pytest.fixture
def pushed(hub: FakeHub, recipe: Path) -> Path:
    """A recipe that is on the hub."""
    push(recipe, NAME)
    hub.requests.clear()
    return recipe


def visible(folder: Path) -> dict[str, str]:
    """Return the files of a dataset; not what the client keeps for itself."""
    return {k: v for k, v in bytes_of(folder).items() if not k.startswith(".")}


def complaint(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Return the last line of a verb that fails as it should."""
    capsys.readouterr()
    assert run(*words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Traceback" not in printed.err
    return printed.err.splitlines()[-1]


def closed_port() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}"


def test_what_is_pushed_comes_back(
    hub: FakeHub, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("push-to-hub", recipe, NAME) == 0
    assert capsys.readouterr().out.startswith(f"{hub.url}/datasets/{NAME}/commit/")
    back = tmp_path / "back"
    assert run("pull", NAME, back) == 0
    assert capsys.readouterr().out == f"{back}\n"
    assert visible(back) == bytes_of(recipe)
    check_files(back)
    assert list(load(back)) == list(load(recipe))


def test_drafts_and_caches_stay_here(hub: FakeHub, recipe: Path) -> None:
    (recipe / ".cache").mkdir()
    (recipe / ".cache" / "token").write_text("secret")
    (recipe / "val" / ".stack.parquet.7.draft").write_text("half")
    push(recipe, NAME)
    assert set(hub.files) == {
        *("README.md", MANIFEST, "test/pass.parquet", "val/stack.parquet")
    }


def test_pushing_twice_uploads_nothing(hub: FakeHub, pushed: Path) -> None:
    before = dict(hub.files)
    push(pushed, NAME)
    assert hub.files == before
    sent = [request for request in hub.requests if "upload/" in request]
    assert sent == [f"POST /api/datasets/{NAME}/preupload/main"]
    assert not any("/commit/" in request for request in hub.requests)


def test_only_what_is_new_is_uploaded(hub: FakeHub, pushed: Path) -> None:
    write_recipe(pushed, [made_up("stack", "val", i) for i in range(4)])
    write_recipe(pushed, [made_up("pass", "test", i) for i in range(3)])
    manifest = json.loads((pushed / MANIFEST).read_text())
    shutil.rmtree(pushed / "val")
    (pushed / MANIFEST).write_text(json.dumps(manifest))
    push(pushed, NAME)
    # The other file has the same bytes, whenever it was written.
    assert not any(request.startswith("PUT") for request in hub.requests)
    assert json.loads(hub.files[MANIFEST]) == manifest


def test_pulling_twice_fetches_nothing(
    hub: FakeHub, pushed: Path, tmp_path: Path
) -> None:
    pull(NAME, tmp_path / "back")
    hub.requests.clear()
    pull(NAME, tmp_path / "back")
    assert not any(request.startswith("GET /datasets") for request in hub.requests)
    assert visible(tmp_path / "back") == bytes_of(pushed)


def test_a_split_alone(hub: FakeHub, pushed: Path, tmp_path: Path) -> None:
    back = tmp_path / "back"
    pull(NAME, back, splits=["val"])
    assert set(visible(back)) == {"README.md", MANIFEST, "val/stack.parquet"}
    # The rest can come later.
    pull(NAME, back)
    assert visible(back) == bytes_of(pushed)


def test_damage_that_stays_is_named_and_does_not_last(
    hub: FakeHub, pushed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hub.damaged["val/stack.parquet"] = 100
    back = tmp_path / "back"
    text = complaint(capsys, "pull", NAME, back)
    assert "val/stack.parquet was damaged" in text
    assert "Run the same command again" in text
    hub.damaged.clear()
    pull(NAME, back)
    assert visible(back) == bytes_of(pushed)


def test_what_is_damaged_is_not_uploaded(
    hub: FakeHub, recipe: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recipe / "val" / "stack.parquet"
    path.write_bytes(path.read_bytes()[:-1])
    assert "another checksum" in complaint(capsys, "push-to-hub", recipe, NAME)
    (recipe / ".parts").mkdir()
    assert "not complete" in complaint(capsys, "push-to-hub", recipe, NAME)
    nothing = complaint(capsys, "push-to-hub", recipe / "none", NAME)
    assert "no dataset" in nothing
    assert hub.requests == []


PUSH, PULL = ("push-to-hub", "HERE", NAME), ("pull", NAME, "BACK")


@pytest.mark.parametrize(
    ("words", "hub_is", "told"),
    [
        (PUSH, {"token": "hf_of_somebody_else"}, "denies access to me/data.* auth"),
        (PULL, {"token": "hf_of_somebody_else"}, "denies access to me/data.* auth"),
        (PUSH, {"status": 403}, "your token lacks the permission"),
        (PUSH, {"status": 500}, "answered 500 about me/data.*Try again later"),
        (PULL, {"status": 500}, "answered 500 about me/data.*Try again later"),
        ((*PULL, "--split", "train"), {}, "me/data has no files of split 'train'"),
        (("pull", NAME, "HERE/README.md/back"), {}, "README.md"),
        *(
            (words, {}, f"{name!r}.*owner/name")
            for name in ("data", "me/data/more", "/data", "me/", "me/a b")
            for words in (("push-to-hub", "HERE", name), ("pull", name, "BACK"))
        ),
    ],
)
def test_complaints(
    hub: FakeHub,
    pushed: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    hub_is: dict[str, Any],
    told: str,
) -> None:
    for name, value in hub_is.items():
        setattr(hub, name, value)
    places = {"HERE": str(pushed), "BACK": str(tmp_path / "back")}
    for name, place in places.items():
        words = tuple(word.replace(name, place) for word in words)
    pattern = told.replace("(", r"\(").replace(")", r"\)")
    assert re.search(pattern, complaint(capsys, *words))


def test_a_repository_or_revision_that_does_not_exist(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = complaint(capsys, "pull", NAME, tmp_path / "back", "--revision", "v9")
    assert f"no dataset {NAME}, or not this revision" in text
    assert not (tmp_path / "back").exists()


@pytest.mark.parametrize("words", [PUSH, PULL])
def test_no_client(
    words: tuple[str, ...],
    recipe: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    text = complaint(capsys, *(word.replace("HERE", str(recipe)) for word in words))
    assert "not installed" in text
    assert "pip install 'lemma-bench[hub]'" in text


@pytest.mark.parametrize("trouble", ["damaged", "cut"])
def test_trouble_on_the_way_is_repaired(
    trouble: str, hub: FakeHub, pushed: Path, tmp_path: Path
) -> None:
    getattr(hub, trouble)["val/stack.parquet"] = 1
    back = tmp_path / "back"
    pull(NAME, back)
    assert getattr(hub, trouble)["val/stack.parquet"] == 0
    assert visible(back) == bytes_of(pushed)
    path = back / "test" / "pass.parquet"
    path.write_bytes(path.read_bytes()[:-1])
    pull(NAME, back)
    assert visible(back) == bytes_of(pushed)


def test_a_file_that_the_hub_lost_is_named(
    hub: FakeHub, pushed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    del hub.files["val/stack.parquet"]
    text = complaint(capsys, "pull", NAME, tmp_path / "back")
    assert text.startswith(f"The dataset in {NAME} is not complete.")
    assert "stack.parquet is missing" in text


def test_no_secret_is_printed(
    hub: FakeHub,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    hub.status = 500
    point_at(hub.url.replace("//", "//me:password@"), monkeypatch)
    text = complaint(capsys, "pull", NAME, tmp_path)
    assert "answered 500" in text
    assert "password" not in text
    monkeypatch.setenv("HF_TOKEN", "hf_ours\N{RIGHT DOUBLE QUOTATION MARK}")
    text = complaint(capsys, "pull", NAME, tmp_path)
    assert "Set HF_TOKEN again" in text
    assert "hf_ours" not in text


def test_an_upload_that_breaks_goes_on_later(
    hub: FakeHub, recipe: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hub.refuses_uploads = True
    text = complaint(capsys, "push-to-hub", recipe, NAME)
    assert "answered 400" in text
    assert hub.files == {}
    hub.refuses_uploads = False
    assert run("push-to-hub", recipe, NAME) == 0
    assert len(hub.files) == 4


@pytest.mark.parametrize("verb", ["push-to-hub", "pull"])
def test_no_network(
    verb: str,
    pushed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    back = tmp_path / "back"
    # Something is there already; still this is no success.
    pull(NAME, back, splits=["val"])
    point_at(closed_port(), monkeypatch)
    words = (pushed, NAME) if verb == "push-to-hub" else (NAME, back)
    text = complaint(capsys, verb, *words)
    assert "The Hub could not be reached" in text
    assert "proxy" in text
    assert "HF_ENDPOINT" in text
    assert set(visible(back)) == {"README.md", MANIFEST, "val/stack.parquet"}


@pytest.mark.slow
def test_offline_by_wish(tmp_path: Path) -> None:
    code = "from lemma.cli.main import main; main()"
    words = ("pull", NAME, str(tmp_path / "back"))
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        env={**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "HF_HUB_OFFLINE" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_not_about_the_hub_is_not_explained(
    pushed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("huggingface_hub.HfApi.dataset_info", fail)
    with pytest.raises(ZeroDivisionError):
        pull(NAME, pushed / "back")
    with pytest.raises(DatasetError, match="no dataset"):
        push(pushed / "back", NAME)
