"""One Ctrl-C ends every verb at once, says what is kept, and leaves nobody behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import ctrl_c
import pytest
from recipes import small_recipe

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc"),
]

COMMAND = "from lemma.cli.main import main\nif __name__ == '__main__': main()"
SOON_S = 3.0

EVALUATE = "evaluate --policy oracle --tasks pass,stack --workers 2 --out OUT"
GENERATE = "generate --tasks pass,stack --split val --workers 2 --out OUT"
RENDER = "render RECIPE --size 64x48 --workers 2 --out OUT"
REPLAY = "replay RECIPE --workers 2"
REPRODUCE = "reproduce oracle --workers 2 --out OUT"
BENCH = "bench pass --expert --workers 2"
DEMO = "demo pass stack --out OUT"


def start(words: str, out: Path) -> subprocess.Popen[str]:
    places = {"OUT": str(out), "RECIPE": ""}
    if "RECIPE" in words:
        places["RECIPE"] = str(small_recipe())
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *(places.get(w, w) for w in words.split())],
        cwd=Path(__file__).parents[1] / "support",
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A group of its own, as a terminal gives it.
        start_new_session=True,
        preexec_fn=ctrl_c.hear,
    )


def group_of(leader: int) -> dict[int, bytes]:
    """Return the processes of a group, with their command lines."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            status = (entry / "stat").read_text().rpartition(")")[2].split()
            if status[2] == str(leader) and status[0] != "Z":
                found[int(entry.name)] = (entry / "cmdline").read_bytes()
        except (OSError, IndexError):
            continue
    return found


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120
    while not what():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def interrupt(process: subprocess.Popen[str], to: str) -> str:
    """Send Ctrl-C, check how it ends, and return what it said."""
    began = time.monotonic()
    (os.killpg if to == "group" else os.kill)(process.pid, signal.SIGINT)
    try:
        _, said = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert time.monotonic() - began < SOON_S
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "Interrupted: " in said
    while left := group_of(process.pid):
        assert time.monotonic() - began < SOON_S, left
        time.sleep(0.02)
    return " ".join(said.split())


@pytest.mark.render
@pytest.mark.parametrize(
    ("words", "to", "kept"),
    [
        (EVALUATE, "group", "of 120 episodes are saved"),
        (EVALUATE, "parent", "of 120 episodes are saved"),
        (GENERATE, "group", "episodes are saved"),
        (RENDER, "parent", "of 12 episodes are saved"),
        (REPLAY, "group", "no file was changed"),
        (REPRODUCE, "parent", "of this experiment are saved"),
        (BENCH, "group", "nothing is saved"),
        (DEMO, "group", "the page is not written"),
    ],
)
def test_one_interrupt_ends_a_verb_and_its_workers(
    words: str, to: str, kept: str, tmp_path: Path
) -> None:
    process = start(words, tmp_path / "out")
    # Even while a worker is starting.
    wait_for(
        lambda: any(b"spawn_main" in line for line in group_of(process.pid).values()),
        process,
    )
    assert kept in interrupt(process, to)


def test_episodes_of_an_interrupted_evaluation_are_kept(tmp_path: Path) -> None:
    words = "evaluate --policy oracle --tasks stack --workers 1 --out OUT"
    process = start(words, tmp_path / "out")
    part = tmp_path / "out" / ".parts" / "high_level-stack-0-10.jsonl"
    wait_for(part.exists, process)
    said = interrupt(process, "group")
    lines = (tmp_path / "out" / "episodes.jsonl").read_text().splitlines()
    assert 10 <= len(lines) < 60
    assert f"Interrupted: {len(lines)} of 60 episodes are saved" in said


def test_serving_ends(tmp_path: Path) -> None:
    process = start("serve --policy faulty_policies:Scripted --port 0", tmp_path)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("Ready")
    interrupt(process, "parent")
