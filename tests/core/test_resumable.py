"""A job that was stopped is continued by the same command, and loses nothing."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from ctrl_c import hear

from lemma.core.errors import DatasetError
from lemma.core.files import only_writer, read_json, write_json, write_text
from lemma.core.workers.pool import ProcessPool, Serial, is_worker
from lemma.core.workers.resumable import (
    Part,
    begin,
    check_same_job,
    differences,
    do_missing,
)

COUNT = 30
"""More parts than are done before the third of three kills."""
RECORD: dict[str, Any] = {
    "size": [2, 3],
    "versions": {"format": "1", "revision": "here"},
}
JOB = """
import sys
from pathlib import Path
from test_resumable import job
if __name__ == "__main__":
    job(Path(sys.argv[1]), 2)
"""


def write_part(folder: str, number: int) -> int:
    time.sleep(0.2 if is_worker() else 0.0)
    write_text(Path(folder) / f"{number}.txt", "x" * number)
    return number


def job(folder: Path, workers: int = 0, told: list[int] | None = None) -> list[int]:
    """Run a job as those of this package are; return the numbers that it made."""
    done = [] if told is None else told
    with only_writer(folder):
        begin(folder, "about.json", RECORD)
        parts = [
            Part((str(folder), number), 1, (folder / f"{number}.txt").exists())
            for number in range(COUNT)
        ]
        engine = ProcessPool(workers) if workers else Serial()
        return [
            number
            for part, number in do_missing(parts, write_part, engine, done.append)
            if part.arguments[1] == number
        ]


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def a_worker_of(parent: int) -> int:
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            above = (entry / "stat").read_text().rpartition(")")[2].split()[1]
            is_worker = b"spawn_main" in (entry / "cmdline").read_bytes()
            if above == str(parent) and is_worker:
                return int(entry.name)
    raise LookupError(parent)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_killed_three_times_it_ends_with_the_same_files(tmp_path: Path) -> None:
    rng, folder = random.Random(7), tmp_path / "killed"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for victim in ("worker", "parent", "interrupt"):
        before = len(list(folder.glob("*.txt")))
        process = subprocess.Popen(
            [sys.executable, "-c", JOB, folder],
            env=environment,
            stderr=subprocess.DEVNULL,
            preexec_fn=hear,
        )
        while len(list(folder.glob("*.txt"))) < before + 2 and process.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.05))
        if victim == "worker":
            os.kill(a_worker_of(process.pid), signal.SIGKILL)
            time.sleep(0.3)
        process.send_signal(signal.SIGINT if victim == "interrupt" else signal.SIGKILL)
        assert process.wait(60) != 0
        # As a writer leaves it that was killed in the middle of a file.
        (folder / ".3.txt.77.draft").write_text("half")
    done: list[int] = []
    made = job(folder, told=done)
    assert 0 < done[0] == COUNT - len(made)
    assert job(folder) == []
    assert job(tmp_path / "quiet") == [*range(COUNT)]
    assert contents(folder) == contents(tmp_path / "quiet")


def test_another_job_is_refused_and_what_is_there_stays(tmp_path: Path) -> None:
    job(tmp_path)
    before = contents(tmp_path)
    other = {"size": (2, 4), "versions": {"format": "2", "revision": "there"}, "b": 1}
    with pytest.raises(DatasetError) as refusal:
        begin(tmp_path, "about.json", other)
    assert str(refusal.value) == (
        f"{tmp_path / 'about.json'} holds another run: b was not given and is now 1; "
        "size was [2, 3] and is now [2, 4]; versions.format was 1 and is now 2. Choose "
        "a new folder, or delete this one."
    )
    assert contents(tmp_path) == before


def test_a_job_that_did_nothing_may_be_begun_otherwise(tmp_path: Path) -> None:
    path, other = tmp_path / "about.json", {"size": [9, 9]}
    begin(tmp_path, "about.json", RECORD)
    for name in (".lock", "episodes.jsonl"):
        (tmp_path / name).touch()
    (tmp_path / ".parts").mkdir()
    begin(tmp_path, "about.json", other)
    assert read_json(path) == other
    write_part(str(tmp_path / ".parts"), 1)
    with pytest.raises(DatasetError, match="another run"):
        begin(tmp_path, "about.json", RECORD)


def test_where_a_job_ran_decides_nothing() -> None:
    same = {"versions": {"format": "1", "revision": "there"}, "size": (2, 3)}
    assert differences(RECORD, same) == []
    assert differences(RECORD, {**same, "optional": None}) == []
    check_same_job(Path("a"), RECORD, same)


def test_what_may_differ_is_chosen_by_the_job() -> None:
    changed = {**RECORD, "size": [9, 9]}
    check_same_job(Path("a"), RECORD, changed, may_differ=["size"])
    with pytest.raises(DatasetError, match=r"size was .* Begin anew\."):
        check_same_job(Path("a"), RECORD, changed, advice="Begin anew.")


def test_a_damaged_record_is_explained(tmp_path: Path) -> None:
    (tmp_path / "about.json").write_text("{")
    with pytest.raises(DatasetError, match="cannot be read"):
        begin(tmp_path, "about.json", RECORD)
    write_json(tmp_path / "about.json", RECORD)
    begin(tmp_path, "about.json", RECORD)
    assert read_json(tmp_path / "about.json") == RECORD
