"""Engines: every job is done once, whoever dies, and nobody outlives Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import ctrl_c
import in_process
import pytest
from tiers import slow_but

from lemma.core.errors import DatasetError, InvalidConfigError, WorkerError
from lemma.core.workers.pool import (
    Engine,
    Job,
    ProcessPool,
    Serial,
    report,
    run_in_order,
)
from lemma.core.workers.ray_cluster import RayCluster
from lemma.core.workers.resources import peak_memory_mb, usable_cores


def double(number: int) -> tuple[int, int]:
    """Return twice the number, and which process says so."""
    time.sleep(0.02)
    return 2 * number, os.getpid()


def fail_at(number: int, wrong: int) -> int:
    if number == wrong:
        raise DatasetError(f"number {number} is wrong")
    return number


def die_once(number: int, folder: str) -> int:
    """Die at every third number, but only the first time."""
    mark = Path(folder) / str(number)
    if number % 3 == 0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_at_seven(number: int) -> int:
    if number == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def pid(number: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def interrupts_are_held(number: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def wait_long(number: int) -> None:
    time.sleep(600)


def count_up(most: int) -> int:
    for number in range(most):
        report(number)
    return most


def first_waits(number: int, folder: Path) -> int:
    """Job 0 waits for job 2, which the other worker begins after it has sent job 1."""
    (folder / str(number)).touch()
    while number == 0 and not (folder / "2").exists():
        time.sleep(0.01)
    return number


def answer_with_a_function(number: int) -> object:
    return lambda: number


class Unsendable(Exception):
    def __init__(self, number: int, *, why: str) -> None:
        super().__init__(f"{number}: {why}")


def fail_unsendably(number: int) -> None:
    raise Unsendable(number, why="it has two arguments")


@pytest.fixture(scope="module", params=["serial", "processes"])
def engine(request: pytest.FixtureRequest) -> Engine:
    return Serial() if request.param == "serial" else ProcessPool(2)


def test_every_job_is_done_as_often_as_it_is_given(engine: Engine) -> None:
    jobs: list[Job] = [*((i,) for i in range(20)), *[(3,)] * 5]
    done = list(engine.run(double, jobs))
    assert sorted(twice for twice, _ in done) == sorted(2 * i for (i,) in jobs)
    assert len({process for _, process in done}) == engine.workers


def test_nothing_to_do(engine: Engine) -> None:
    assert list(engine.run(double, [])) == []


def test_what_a_job_raises_comes_out_and_says_where(engine: Engine) -> None:
    with pytest.raises(DatasetError, match="number 4 is wrong") as caught:
        list(engine.run(fail_at, [(i, 4) for i in range(10)]))
    if engine.workers > 1:
        assert "in fail_at" in caught.value.__notes__[0]


@pytest.mark.slow
def test_no_more_processes_than_jobs_are_started() -> None:
    assert len(set(ProcessPool(64).run(pid, [(0,), (1,)]))) <= 2


def test_a_worker_that_dies_is_replaced(tmp_path: Path) -> None:
    jobs: list[Job] = [(i, str(tmp_path)) for i in range(6)]
    assert sorted(ProcessPool(2).run(die_once, jobs)) == list(range(6))
    assert len(list(tmp_path.iterdir())) == 2


def run_program(folder: Path, *lines: str) -> "subprocess.CompletedProcess[str]":
    """Run a program with a pool; workers import it as __mp_main__."""
    program = folder / "program.py"
    start = "print(list(ProcessPool(2).run(sqrt, [(4,), (4,)])))"
    imports = ("import os", "import signal", "from math import sqrt")
    pool = "from lemma.core.workers.pool import ProcessPool"
    program.write_text("\n".join([*imports, pool, *lines]) + f" {start}\n")
    command = [sys.executable, str(program)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=folder
    )


@pytest.mark.slow
def test_a_program_that_workers_would_run_again_is_told_so(tmp_path: Path) -> None:
    ended = run_program(tmp_path, "if True:")
    assert ended.returncode == 1
    last = ended.stderr.splitlines()[-1]
    assert "before it could begin" in last
    assert "if __name__" in last
    assert "memory" not in last


@pytest.mark.slow
def test_a_worker_that_is_killed_before_it_begins_is_replaced(tmp_path: Path) -> None:
    ended = run_program(
        tmp_path,
        "if __name__ == '__mp_main__' and not os.path.exists('killed'):",
        "    open('killed', 'w').close()",
        "    os.kill(os.getpid(), signal.SIGKILL)",
        "if __name__ == '__main__':",
    )
    assert (ended.returncode, ended.stdout) == (0, "[2.0, 2.0]\n")
    assert (tmp_path / "killed").exists()


@pytest.mark.slow
def test_workers_that_always_die_are_not_replaced_for_ever_nor_others_lost() -> None:
    jobs: list[Job] = [(7,), *((i,) for i in range(3))]
    results = ProcessPool(2).run(die_at_seven, jobs)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(WorkerError, match=r"5 worker processes died.*--workers"):
        next(results)


def test_reports_arrive_before_the_job_has_ended(engine: Engine) -> None:
    heard: list[int] = []
    for most in engine.run(count_up, [(3,)] * 4, heard.append):
        assert len(heard) >= most
    assert sorted(heard) == sorted([0, 1, 2] * 4)


def test_outside_of_a_job_nobody_hears_reports() -> None:
    assert count_up(2) == 2


@pytest.mark.slow
def test_results_in_the_order_of_the_jobs(tmp_path: Path) -> None:
    jobs: list[Job] = [(i, tmp_path) for i in range(8)]
    pool = ProcessPool(2)
    assert list(run_in_order(pool, first_waits, jobs)) == list(range(8))
    (tmp_path / "2").unlink()
    assert next(pool.run(first_waits, jobs)) != 0


@pytest.mark.slow
def test_what_cannot_be_sent_is_an_error_with_its_cause() -> None:
    with pytest.raises(AttributeError, match="lambda"):
        list(ProcessPool(1).run(answer_with_a_function, [(0,)]))
    with pytest.raises(WorkerError, match=r"Unsendable.*it has two arguments"):
        list(ProcessPool(1).run(fail_unsendably, [(3,)]))


@pytest.mark.slow
def test_workers_are_gone_when_the_iteration_ends() -> None:
    before = children(os.getpid())
    results = ProcessPool(2).run(pid, [(i,) for i in range(100)])
    assert next(results) in children(os.getpid())
    start = time.monotonic()
    results.close()  # type: ignore[attr-defined]
    assert time.monotonic() - start < 1.0
    # The process that tracks semaphores stays.
    assert len(children(os.getpid()) - before) <= 1


def test_ctrl_c_is_not_for_workers() -> None:
    assert all(ProcessPool(1).run(interrupts_are_held, [(0,)]))
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_there_must_be_workers() -> None:
    with pytest.raises(InvalidConfigError, match="1 or more"):
        ProcessPool(0)


def test_an_engine_says_how_many_work() -> None:
    assert (Serial().workers, ProcessPool(3).workers) == (1, 3)
    assert ProcessPool().workers == usable_cores()


def needs_memory(megabytes: int) -> float:
    """Return the peak of a process that needs so much."""
    before = peak_memory_mb()
    block = bytearray(megabytes * 1_000_000)
    block[::4096] = b"x" * len(block[::4096])
    assert len(block) == megabytes * 1_000_000
    return peak_memory_mb() - before


def test_memory_is_measured() -> None:
    # In a process of its own: this one may have needed more before.
    (grown,) = ProcessPool(1).run(needs_memory, [(80,)])
    assert 70 < grown < 200
    assert 10 < peak_memory_mb() < 10_000


def children(parent: int) -> set[int]:
    """Return the processes that a process has started, and theirs."""
    lines = subprocess.run(
        ["ps", "-A", "-o", "pid=,ppid="], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    found, pairs = {parent}, [tuple(map(int, line.split())) for line in lines]
    for _ in range(4):
        found |= {child for child, above in pairs if above in found}
    return found - {parent}


def alive(processes: set[int]) -> set[int]:
    return {process for process in processes if Path(f"/proc/{process}/exe").exists()}


@pytest.fixture
def parent() -> Iterator[subprocess.Popen[bytes]]:
    """Start a process with two workers that would work for ten minutes."""
    folders = [str(Path(__file__).parent), str(Path(in_process.__file__).parent)]
    code = (
        f"import sys; sys.path[:0] = {folders}\n"
        "from lemma.core.workers.pool import ProcessPool\n"
        "from test_pool import wait_long\n"
        "if __name__ == '__main__':\n"
        "    list(ProcessPool(2).run(wait_long, [(0,), (1,)]))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=ctrl_c.hear,
    )
    yield process
    process.kill()
    process.communicate()


def workers_of(parent: subprocess.Popen[bytes]) -> set[int]:
    deadline = time.monotonic() + 30
    # Two workers, and the process that keeps account of semaphores.
    while len(started := children(parent.pid)) < 3 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert len(started) == 3
    # Workers that are still starting cannot know yet.
    time.sleep(1.0)
    return started


def all_end(processes: set[int]) -> bool:
    deadline = time.monotonic() + 10
    while alive(processes) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not alive(processes)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_end_with_the_process_that_started_them(
    parent: subprocess.Popen[bytes],
) -> None:
    started = workers_of(parent)
    parent.kill()
    parent.wait()
    assert all_end(started)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("to", slow_but(["parent", "group"], "group"))
def test_ctrl_c_ends_everything_at_once(
    parent: subprocess.Popen[bytes], to: str
) -> None:
    started = workers_of(parent)
    start = time.monotonic()
    (os.killpg if to == "group" else os.kill)(parent.pid, signal.SIGINT)
    _, said = parent.communicate(timeout=10)
    assert time.monotonic() - start < 2.0
    assert all_end(started)
    # One traceback: that of the process whose job it is to say something.
    assert said.count(b"Traceback") == 1
    assert said.rstrip().endswith(b"KeyboardInterrupt")


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(WorkerError, match=r"lemma-bench\[scale\]"):
        RayCluster("auto")
