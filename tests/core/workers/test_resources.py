"""How many cores a process may use: affinity, and quotas of both control groups."""

from pathlib import Path

import pytest

from lemma.core.workers import resources
from lemma.core.workers.resources import usable_cores


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A system without quotas that lets this process run on eight cores."""
    monkeypatch.setattr(resources, "PROCESS", tmp_path)
    monkeypatch.setattr(resources, "CONTROL_GROUPS", tmp_path)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(8)), raising=False)
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("told", "cores"), [("max 100000", 8), ("250000 100000", 3), ("1000 100000", 1)]
)
def test_a_quota_of_version_2_counts(system: Path, told: str, cores: int) -> None:
    write(system / "cgroup", "0::/jobs/mine\n")
    write(system / "jobs" / "cpu.max", told)
    write(system / "jobs" / "mine" / "cpu.max", "max 100000")
    assert usable_cores() == cores


@pytest.mark.parametrize(("quota", "cores"), [(-1, 8), (200000, 2), (150000, 2)])
def test_a_quota_of_version_1_counts(system: Path, quota: int, cores: int) -> None:
    write(system / "cgroup", "4:memory:/x\n3:cpu,cpuacct:/docker/of-the-host\n0::/\n")
    write(system / "cpu" / "cpu.cfs_quota_us", str(quota))
    write(system / "cpu" / "cpu.cfs_period_us", "100000")
    assert usable_cores() == cores


@pytest.mark.parametrize("told", [None, "", "0::/\n"])
def test_without_groups_the_affinity_counts(system: Path, told: str | None) -> None:
    if told is not None:
        write(system / "cgroup", told)
    assert usable_cores() == 8
