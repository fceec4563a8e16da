"""Killed at random moments, over and over: in the end the same bytes."""

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from recipes import bytes_of

from lemma.core.workers.serial import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc"),
]

KILLS = 20
SEED = 7
EPISODES = 18
WORDS = ("generate", "--tasks", "pass,stack", "--split", "val", "--workers", "2")


def start(folder: Path) -> subprocess.Popen[bytes]:
    code = "from lemma.cli.main import main\nif __name__ == '__main__': main()"
    words = (*WORDS, "--episodes", str(EPISODES), "--out", str(folder))
    return subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def workers(parent: int) -> list[int]:
    """Return the workers of a process that are at work, or about to be."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            above = (entry / "stat").read_text().rpartition(")")[2].split()[1]
            if above != str(parent):
                continue
            words = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if b"spawn_main" in words:
            found.append(int(entry.name))
    return found


def kill(process: int) -> bool:
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def episodes_in(folder: Path) -> int:
    """Return how many episodes lie in parts, or in files put together from them."""
    parts = count(folder / ".parts")
    return parts + EPISODES * count(folder)


def count(folder: Path) -> int:
    """Return how many tables lie in the folders of a folder."""
    found = 0
    with suppress(FileNotFoundError):
        for inner in os.listdir(folder):
            if not inner.startswith("."):
                with suppress(FileNotFoundError, NotADirectoryError):
                    names = os.listdir(folder / inner)
                    found += sum(name.endswith(".parquet") for name in names)
    return found


def wait_for(process: subprocess.Popen[bytes], what: Callable[[], bool]) -> None:
    """Wait until something is so, or the process has ended."""
    deadline = time.monotonic() + 60
    while not what() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)


def disturb(folder: Path, rng: random.Random) -> Counter[str]:
    """Start a run, kill what it consists of, and return how many of which."""
    killed: Counter[str] = Counter()
    # Anything from the first import to the end of the fifth episode, counted in what
    # is done, because a busy machine takes longer for it.
    wanted = episodes_in(folder) + rng.randrange(6)
    process = start(folder)
    wait_for(process, lambda: episodes_in(folder) >= wanted)
    time.sleep(rng.uniform(0.0, 0.6))
    if rng.random() < 0.5:
        # It loses a worker, starts others, and goes on for a while.
        wait_for(process, lambda: bool(workers(process.pid)))
        if victims := workers(process.pid):
            killed["worker"] += kill(rng.choice(victims))
        time.sleep(rng.uniform(0.0, 1.2))
    if process.poll() is None:
        process.kill()
        killed["parent"] += 1
    process.wait()
    return killed


def test_killed_twenty_times_it_ends_with_the_same_bytes(tmp_path: Path) -> None:
    order = GenerateConfig(
        out=tmp_path / "quiet",
        tasks=("pass", "stack"),
        splits=("val",),
        episodes=EPISODES,
    )
    generate(order, Serial())
    folder, rng = tmp_path / "killed", random.Random(SEED)
    killed: Counter[str] = Counter()
    resumed = 0
    while killed.total() < KILLS:
        resumed += episodes_in(folder) > 0
        killed += disturb(folder, rng)
        if (folder / "manifest.json").exists() and not (folder / ".parts").exists():
            # It was done: begin again, so that every kill hits something.
            assert bytes_of(folder) == bytes_of(order.out)
            folder.rename(tmp_path / f"done-{killed.total()}")
    assert min(killed["parent"], killed["worker"]) >= KILLS // 5
    assert resumed >= KILLS // 3
    process = start(folder)
    assert process.wait(timeout=120) == 0
    assert bytes_of(folder) == bytes_of(order.out)
