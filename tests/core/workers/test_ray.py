"""A Ray cluster of two nodes: the same bytes, also when one of the nodes dies."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import ray
from command import run as lemma
from own_plugins import loaded
from ray.cluster_utils import Cluster
from recipes import bytes_of, small_recipe

from lemma.core.errors import DatasetError, WorkerError
from lemma.core.files import read_json
from lemma.core.plugins import load_plugins
from lemma.core.workers.pool import Serial, is_worker
from lemma.core.workers.ray_cluster import RayCluster
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.render import RenderConfig, render

pytestmark = pytest.mark.slow

NODE = {"num_cpus": 1, "object_store_memory": 80_000_000}
COMMAND = "from lemma.cli.main import main\nif __name__ == '__main__': main()"
ON_RAY = ("--engine", "ray", "--ray-address", "auto")
GENERATE = (
    *("generate", "--tasks", "pass,stack", "--split", "val,test", "--episodes", "3"),
    *ON_RAY,
)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    found = Cluster(
        initialize_head=True, head_node_args={**NODE, "include_dashboard": False}
    )
    found.add_node(**NODE)
    yield found
    found.shutdown()


def start(cluster: Cluster, *words: object, cwd: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *map(str, words)],
        # The meaning of "auto", in case that somebody has a cluster here.
        env={**os.environ, "RAY_ADDRESS": cluster.address},
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> str:
    """Wait for a command that should succeed, and return what it printed."""
    output, complaint = process.communicate(timeout=120)
    assert process.returncode == 0, complaint
    return output


def wait_for(what: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 60
    while not what() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert what()


def test_two_nodes_write_the_same_bytes(cluster: Cluster, tmp_path: Path) -> None:
    # A relative path, which is another one where the workers are at home.
    output = finish(start(cluster, *GENERATE, "--out", "recipe", cwd=tmp_path))
    assert "Every episode equals the published one" in output
    assert bytes_of(tmp_path / "recipe") == bytes_of(small_recipe())


@pytest.fixture
def here(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """This process is the one that asks the cluster."""
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    yield
    ray.shutdown()


@pytest.mark.usefixtures("here")
def test_replays_on_two_nodes(capsys: pytest.CaptureFixture[str]) -> None:
    assert lemma("replay", small_recipe(), "--limit", 4, *ON_RAY) == 0
    assert "All 4 episodes are reproduced to the bit" in capsys.readouterr().out


@pytest.mark.render
@pytest.mark.usefixtures("here")
def test_two_nodes_render_the_same_bytes(tmp_path: Path) -> None:
    config = RenderConfig(recipe=small_recipe(), tasks=("pass",), out=tmp_path / "b")
    words = ("render", small_recipe(), "--tasks", "pass", "--size", "64x48")
    assert lemma(*words, "--out", tmp_path / "a", *ON_RAY) == 0
    render(config, KeyframeForm(64, 48), Serial())
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")


def test_a_node_that_dies_costs_time_and_nothing_else(
    cluster: Cluster, tmp_path: Path
) -> None:
    victim = cluster.add_node(**NODE)
    folder = tmp_path / "recipe"
    process = start(cluster, *GENERATE, "--out", folder, cwd=tmp_path)
    wait_for(lambda: len(list(folder.glob(".parts/*/*.parquet"))) >= 2)
    cluster.remove_node(victim, allow_graceful=False)
    finish(process)
    assert bytes_of(folder) == bytes_of(small_recipe())


@pytest.fixture
def engine(cluster: Cluster) -> Iterator[RayCluster]:
    yield RayCluster(cluster.address)
    ray.shutdown()


# Waits for the other one. Ray tells its workers which node started them.
MEET = """touch {folder}/{number}
until [ -e {folder}/0 ] && [ -e {folder}/1 ]; do sleep 0.1; done
echo {number} $RAY_RAYLET_PID"""


def test_jobs_run_on_both_nodes_at_a_time(engine: RayCluster, tmp_path: Path) -> None:
    assert engine.workers >= 2
    jobs = [(["sh", "-c", MEET.format(folder=tmp_path, number=i)],) for i in range(2)]
    done = dict(map(bytes.split, engine.run(subprocess.check_output, jobs)))
    assert set(done) == {b"0", b"1"}
    assert done[b"0"] != done[b"1"]


def test_workers_know_that_they_are(engine: RayCluster) -> None:
    assert list(engine.run(is_worker, [()])) == [True]
    assert not is_worker()


def test_plugins_are_loaded_there_too(engine: RayCluster, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("")
    with loaded(path):
        assert list(engine.run(load_plugins, [()])) == [(str(path),)]


def test_what_a_job_raises_comes_out(engine: RayCluster, tmp_path: Path) -> None:
    job = (tmp_path / "none.json",)
    with pytest.raises(DatasetError, match=r"none\.json is missing"):
        list(engine.run(read_json, [job] * 3))


def test_a_job_that_always_dies_is_given_up(engine: RayCluster) -> None:
    with pytest.raises(WorkerError, match=r"cluster lost a job.*same command again"):
        list(engine.run(os._exit, [(1,)]))


def test_no_cluster_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for address in ("127.0.0.1:1", "ray://me:password@127.0.0.1:1"):
        words = (*GENERATE[:-1], address, "--out", tmp_path / "recipe")
        assert lemma(*words) == 2
        said = capsys.readouterr().err
        assert "There is no Ray cluster at '" in said
        assert "127.0.0.1:1'" in said
        assert "password" not in said
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    assert lemma(*GENERATE, "--out", tmp_path / "recipe") == 2
    assert "There is no Ray cluster at 'auto'" in capsys.readouterr().err
    assert not (tmp_path / "recipe").exists()
