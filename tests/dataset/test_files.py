"""Files that are whole or not there, and complaints that say what to do."""

import errno
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from interpreter import python
from recipes import made_up, small_order, write_recipe

from lemma.core.errors import DatasetError
from lemma.core.files import (
    clear_drafts,
    only_writer,
    read_json,
    write_json,
    write_text,
    write_whole,
)
from lemma.core.workers.pool import Serial
from lemma.dataset.files import MANIFEST, check_files
from lemma.dataset.recipe import files
from lemma.dataset.recipe.files import (
    METADATA_KEY,
    REVISION_VARIABLE,
    open_table,
    read_table,
    versions,
    write_table,
)
from lemma.dataset.recipe.generate import generate
from lemma.dataset.recipe.schema import from_table, to_table
from lemma.tasks.instance import BENCHMARK_VERSION
from make_recipe import export

ABOUT = versions(BENCHMARK_VERSION)


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    write_text(tmp_path / "deep" / "er" / "note.txt", "ä")
    assert (tmp_path / "deep/er/note.txt").read_text(encoding="utf-8") == "ä"
    assert hidden(tmp_path) == []


@pytest.mark.parametrize("error", [OSError(errno.EIO, "broken"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, error: BaseException
) -> None:
    path = tmp_path / "note.txt"
    path.write_text("old")

    def write(draft: Path) -> None:
        draft.write_text("half of the n")
        raise error

    with pytest.raises((DatasetError, KeyboardInterrupt)):
        write_whole(path, write)
    assert path.read_text() == "old"
    assert hidden(tmp_path) == []


def test_a_full_disk_is_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    path = write_old(tmp_path)
    with pytest.raises(DatasetError, match=r"disk is full.*before is lost.*again"):
        write_table(path, to_table([made_up(index=1)]), ABOUT)
    assert [record.index for record in from_table(read_table(path))] == [0]
    assert hidden(tmp_path) == []


def write_old(folder: Path) -> Path:
    path = folder / "some.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        write_table(path, to_table([made_up()]), ABOUT)
    return path


def test_a_folder_that_may_not_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", fail)
    for write in (write_text_there, hold):
        with pytest.raises(DatasetError, match=r"Permission denied.*Choose a folder"):
            write(tmp_path / "closed")


def write_text_there(folder: Path) -> None:
    write_text(folder / "note.txt", "text")


def hold(folder: Path) -> None:
    with only_writer(folder):
        pass


def test_a_folder_has_one_writer(tmp_path: Path) -> None:
    with only_writer(tmp_path):
        code = (
            "import sys; from pathlib import Path\n"
            "from lemma.core.files import only_writer\n"
            "with only_writer(Path(sys.argv[1])): pass"
        )
        done = python("-c", code, tmp_path)
        assert "Another process is writing" in done.stderr
    hold(tmp_path)
    # An empty file that costs nothing; to remove it would let two of them in.
    assert [path.name for path in tmp_path.iterdir()] == [".lock"]


def test_drafts_are_cleared_and_nothing_else(tmp_path: Path) -> None:
    kept = [tmp_path / "a.parquet", tmp_path / ".hidden", tmp_path / "b.draft"]
    for path in (*kept, tmp_path / ".a.parquet.77.draft", tmp_path / "x/.b.5.draft"):
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    clear_drafts(tmp_path)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == set(kept)


def test_bytes_do_not_depend_on_how_a_table_was_put_together(tmp_path: Path) -> None:
    records = [made_up(index=i) for i in range(30)]
    whole = to_table(records)
    pieces = pa.concat_tables([to_table([record]) for record in records])
    write_table(tmp_path / "a.parquet", whole, ABOUT)
    write_table(tmp_path / "b.parquet", pieces, ABOUT)
    assert (tmp_path / "a.parquet").read_bytes() == (
        tmp_path / "b.parquet"
    ).read_bytes()


def test_a_file_says_what_wrote_it(tmp_path: Path) -> None:
    write_table(tmp_path / "a.parquet", to_table([made_up()]), ABOUT)
    _, about = open_table(tmp_path / "a.parquet")
    assert about == ABOUT
    names = {"format", "benchmark", "lemma", "mujoco", "numpy", "numba", "revision"}
    assert set(about) == names


def test_the_parquet_of_somebody_else_is_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"a": [1]}), tmp_path / "a.parquet")
    with pytest.raises(DatasetError, match="not a recipe of this benchmark"):
        open_table(tmp_path / "a.parquet")
    # Ours by its metadata alone.
    table = pa.table({"a": [1]}).replace_schema_metadata({METADATA_KEY: b"{}"})
    pq.write_table(table, tmp_path / "b.parquet")
    with pytest.raises(DatasetError, match="not a recipe of this benchmark"):
        open_table(tmp_path / "b.parquet")


def test_a_later_format_is_refused(tmp_path: Path) -> None:
    about = {**ABOUT, "format": "9", "lemma": "7.0.0"}
    write_table(tmp_path / "a.parquet", to_table([made_up()]), about)
    with pytest.raises(DatasetError, match=r"format 9.*format 1.*7\.0\.0"):
        open_table(tmp_path / "a.parquet")


def test_checksums(tmp_path: Path) -> None:
    path = write_recipe(tmp_path, [made_up()])
    check_files(tmp_path)
    manifest = read_json(tmp_path / MANIFEST)
    manifest["files"]["val/stack.parquet"]["sha256"] = "00"
    write_json(tmp_path / MANIFEST, manifest)
    with pytest.raises(DatasetError, match=r"stack\.parquet has another checksum"):
        check_files(tmp_path)
    path.unlink()
    with pytest.raises(DatasetError, match=r"stack\.parquet is missing"):
        check_files(tmp_path)
    check_files(tmp_path, partial=True)


def test_a_file_that_nobody_listed(tmp_path: Path) -> None:
    write_recipe(tmp_path, [made_up("pass")])
    write_recipe(tmp_path, [made_up("stack")])
    with pytest.raises(DatasetError, match=r"pass\.parquet is not in manifest"):
        check_files(tmp_path)


DEEP = '{"files":' * 5000 + "1" + "}" * 5000


@pytest.mark.parametrize(
    "content",
    [
        *("{", "[1]", "", "null", "\xff{", DEEP, "[" * 100_000),
        *('{"files": 3}', '{"files": {"a": 3}}', '{"files": {"a": {}}}'),
        '{"files": {"a": {"sha256": 3}}}',
        '{"files": {"a": {"sha256": "00", "digests": 3}}}',
        '{"files": {"../a": {"sha256": "00"}}}',
        '{"files": {"/etc/passwd": {"sha256": "00"}}}',
    ],
    ids=range(14),
)
def test_a_damaged_manifest(tmp_path: Path, content: str) -> None:
    (tmp_path / MANIFEST).write_text(content)
    with pytest.raises(DatasetError, match=r"manifest\.json"):
        check_files(tmp_path)


@pytest.mark.parametrize("versions", ["3", "[]", '{"lemma": 3}', "null"])
def test_versions_of_a_manifest_that_are_none(tmp_path: Path, versions: str) -> None:
    (tmp_path / MANIFEST).write_text(f'{{"files": {{}}, "versions": {versions}}}')
    with pytest.raises(DatasetError, match=r"manifest\.json is damaged"):
        export(tmp_path, tmp_path / "digests")
    with pytest.raises(DatasetError, match=r"manifest\.json is damaged"):
        generate(small_order(tmp_path), Serial())


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"3", DEEP.encode(), b"\xff"])
def test_metadata_that_are_no_json_object(tmp_path: Path, text: bytes) -> None:
    table = to_table([made_up()]).replace_schema_metadata({METADATA_KEY: text})
    pq.write_table(table, tmp_path / "a.parquet")
    with pytest.raises(DatasetError, match=r"a\.parquet"):
        open_table(tmp_path / "a.parquet")


@pytest.mark.parametrize("text", ["", "[]", "{", DEEP])
def test_an_instance_that_is_no_json_object(text: str) -> None:
    record = replace(made_up(), instance=text)
    with pytest.raises(DatasetError, match=r"the instance of .* cannot be read"):
        record.instance_data()


def test_the_revision_is_never_that_of_somebody_elses_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(REVISION_VARIABLE)
    package = tmp_path / "project" / ".venv" / "lib" / "lemma" / "dataset"
    package.mkdir(parents=True)
    subprocess.run(["git", "init", "-q", str(tmp_path / "project")], check=True)
    monkeypatch.setattr(files, "__file__", str(package / "recipe" / "files.py"))
    assert versions(BENCHMARK_VERSION)["revision"] == "release"


def test_where_git_does_not_say_the_revision_it_is_no_release(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(REVISION_VARIABLE)
    package = tmp_path / "src" / "lemma" / "dataset" / "recipe"
    package.mkdir(parents=True)
    monkeypatch.setattr(files, "__file__", str(package / "files.py"))
    assert versions(BENCHMARK_VERSION)["revision"] == "unknown"
    # As a checkout of another owner, which git does not trust.
    (tmp_path / ".git").write_text("gitdir: nowhere")
    assert versions(BENCHMARK_VERSION)["revision"] == "unknown"
