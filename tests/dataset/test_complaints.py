"""Every command names the file that is wrong, and says what to do; nothing is lost."""

from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import pytest
from command import run as lemma
from recipes import (
    bytes_of,
    remembered,
    remount,
    small_disk,
    small_order,
    small_recipe,
    write_recipe,
)

from lemma.core.files import read_json, sha256_of, write_json
from lemma.core.workers.pool import Serial
from lemma.dataset.files import MANIFEST
from lemma.dataset.recipe import generate as generating
from lemma.dataset.recipe.files import load, open_table, read_table, write_table
from lemma.dataset.recipe.generate import generate
from lemma.tasks.instance import BENCHMARK_VERSION

NAME = "val/stack.parquet"
GENERATE = (
    *("generate", "--tasks", "pass,stack", "--split", "val,test"),
    *("--episodes", "3", "--workers", "2"),
)


@pytest.fixture(autouse=True)
def _quick_expert(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no episode be played that was played for the small recipe."""
    small_recipe()
    monkeypatch.setattr(generating, "record_episode", remembered)


def words_of(verb: str) -> tuple[str, ...]:
    """Return a command that lacks ``--out`` alone."""
    if verb == "generate":
        return GENERATE
    return ("render", str(small_recipe()), "--size", "64x48")


def truncate(folder: Path) -> None:
    path = folder / NAME
    path.write_bytes(path.read_bytes()[:-1000])


def empty(folder: Path) -> None:
    (folder / NAME).write_bytes(b"")


def flip(folder: Path) -> None:
    # Of the statistics in the footer: what Parquet itself does not notice.
    data = bytearray((folder / NAME).read_bytes())
    data[data.rindex(f"{BENCHMARK_VERSION}/stack/val/2".encode())] ^= 1
    (folder / NAME).write_bytes(data)


def change_sum(folder: Path) -> None:
    manifest = read_json(folder / MANIFEST)
    manifest["files"][NAME]["sha256"] = "0" * 64
    write_json(folder / MANIFEST, manifest)


def break_manifest(folder: Path) -> None:
    (folder / MANIFEST).write_text("{")


def change_engine(folder: Path) -> None:
    table, about = read_table(folder / NAME), open_table(folder / NAME)[1]
    write_table(folder / NAME, table, {**about, "mujoco": "3.16.0"})
    manifest = read_json(folder / MANIFEST)
    manifest["files"][NAME]["sha256"] = sha256_of(folder / NAME)
    write_json(folder / MANIFEST, manifest)


DAMAGES: dict[Callable[[Path], None], str] = {
    truncate: "stack.parquet is damaged: Parquet magic bytes not found",
    empty: "stack.parquet is damaged: Parquet file size is 0 bytes",
    flip: "stack.parquet has another checksum than in manifest.json",
    change_sum: "stack.parquet has another checksum than in manifest.json",
    break_manifest: "manifest.json cannot be read",
    change_engine: "3.16.0",
}


@pytest.mark.parametrize(
    ("verb", "damage"),
    [
        # Every damage once, and every command with one of each kind.
        *(("generate", damage) for damage in DAMAGES),
        *(("replay", damage) for damage in (truncate, change_sum, change_engine)),
        *(("render", damage) for damage in (flip, break_manifest, change_engine)),
    ],
)
def test_damage_is_named_by_every_command(
    verb: str,
    damage: Callable[[Path], None],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, out = copytree(small_recipe(), tmp_path / "copy"), tmp_path / "out"
    damage(folder)
    before = bytes_of(folder)
    words: tuple[object, ...] = (*GENERATE, "--out", folder)
    if verb != "generate":
        words = (verb, folder, "--workers", 1)
    if verb == "render":
        words += ("--size", "64x48", "--out", out)
    assert lemma(*words) == 2
    complaint = " ".join(capsys.readouterr().err.split())
    assert DAMAGES[damage] in complaint
    assert any(w in complaint for w in ("Delete it", "delete it", "Install", "folder"))
    assert "Traceback" not in complaint
    assert bytes_of(folder) == before
    assert not out.exists()


def test_what_is_deleted_is_made_again(tmp_path: Path) -> None:
    folder = copytree(small_recipe(), tmp_path / "copy")
    change_sum(folder)
    (folder / NAME).unlink()
    assert generate(small_order(folder), Serial()).made == 3
    assert bytes_of(folder) == bytes_of(small_recipe())


@pytest.mark.slow
def test_a_full_disk_loses_nothing_through_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path / "disk", 100) as disk:
        assert lemma(*GENERATE, "--out", disk / "recipe", processes=True) == 2
        complaint = capsys.readouterr().err
        assert "The disk is full" in complaint
        assert "run the same command again" in " ".join(complaint.split())
        kept = bytes_of(disk)
        assert sum(name.endswith(".parquet") for name in kept) > 0
        remount(disk, "size=20m")
        counts: list[int] = []
        generate(small_order(disk / "recipe"), Serial(), counts.append)
        assert counts[0] > 0
        assert bytes_of(disk / "recipe") == bytes_of(small_recipe())


@pytest.mark.slow
@pytest.mark.render
def test_a_full_disk_while_rendering(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path / "disk", 100) as disk:
        words = ("render", small_recipe(), "--size", "64x48", "--out", disk / "set")
        assert lemma(*words, processes=True) == 2
        assert "The disk is full" in capsys.readouterr().err
        kept = bytes_of(disk / "set")
        remount(disk, "size=20m")
        assert lemma(*words, processes=True) == 0
        made = bytes_of(disk / "set")
    assert lemma(*words[:-1], tmp_path / "set") == 0
    assert made == bytes_of(tmp_path / "set")
    # The record of the job goes when the job is done.
    kept.pop(".parts/about.json", None)
    assert kept.items() <= made.items()


def test_a_disk_that_may_only_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with small_disk(tmp_path / "disk", 1000) as disk:
        folder = copytree(small_recipe(), disk / "recipe")
        remount(disk, "ro")
        for words in (
            (*GENERATE, "--out", disk / "new"),
            ("render", folder, "--size", "64x48", "--out", disk / "set"),
        ):
            assert lemma(*words) == 2
            complaint = " ".join(capsys.readouterr().err.split())
            assert "cannot be written: Read-only file system. Choose" in complaint
        assert lemma("replay", folder, "--limit", 1, "--workers", 1) == 0


@pytest.mark.parametrize("verb", ["generate", "render"])
def test_a_file_where_the_folder_should_be(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    assert lemma(*words_of(verb), "--out", tmp_path / "file") == 2
    assert "cannot be written: File exists" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.render
def test_what_was_rendered_is_no_place_for_a_recipe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("render", small_recipe(), "--size", "64x48", "--out", tmp_path)
    assert lemma(*words, "--tasks", "pass", "--workers", 1) == 0
    before = bytes_of(tmp_path)
    assert lemma(*GENERATE, "--out", tmp_path) == 2
    assert "contains 'keyframes'" in capsys.readouterr().err
    assert bytes_of(tmp_path) == before


@pytest.mark.parametrize("verb", ["generate", "render"])
def test_the_readme_of_somebody_else_is_not_written_over(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "README.md").write_text("mine")
    assert lemma(*words_of(verb), "--out", tmp_path) == 2
    assert "but no dataset" in capsys.readouterr().err
    assert bytes_of(tmp_path).keys() <= {".lock", "README.md"}


def test_a_run_that_grew_a_file_and_was_killed_did_no_damage(tmp_path: Path) -> None:
    recipe = list(load(small_recipe()).select(task="stack", split="val"))
    about = open_table(small_recipe() / NAME)[1]
    write_recipe(tmp_path, recipe[:1], about)
    order = small_order(tmp_path)

    def die(count: int) -> None:
        # Once the grown file is there, and before the manifest is.
        if load(tmp_path).select(task="stack", split="val")[1:]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(order, Serial(), die)
    assert len(load(tmp_path).select(task="stack", split="val")) == 3
    generate(order, Serial())
    assert bytes_of(tmp_path) == bytes_of(small_recipe())
