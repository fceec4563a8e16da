"""How many processors and how much memory this process has."""

import math
import os
import sys
from pathlib import Path, PurePosixPath

PROCESS = Path("/proc/self")
CONTROL_GROUPS = Path("/sys/fs/cgroup")


def usable_cores() -> int:
    """Return how many cores this process may keep busy.

    The scheduler's affinity limits it, and so does a quota of processor time, as
    ``docker --cpus`` and limits of Kubernetes set it; parts of a core count as one.
    """
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    return max(1, math.ceil(min(cores, _quota())))


def _quota() -> float:
    """Return how many cores' time the control groups of this process may use."""
    try:
        lines = (PROCESS / "cgroup").read_text("utf-8").splitlines()
    except (OSError, ValueError):
        return math.inf
    quota = math.inf
    for line in lines:
        _, controllers, path = line.split(":", 2)
        group = PurePosixPath(path)
        # In a container, folders of the host are missing: each parent is looked at.
        for folder in (group, *group.parents):
            below = str(folder).lstrip("/")
            if controllers == "":
                quota = min(quota, _unified(CONTROL_GROUPS / below))
            elif "cpu" in controllers.split(","):
                quota = min(quota, _legacy(CONTROL_GROUPS / "cpu" / below))
    return quota


def _unified(folder: Path) -> float:
    """Return the quota of a group of version 2."""
    try:
        quota, period = (folder / "cpu.max").read_text("utf-8").split()
        return math.inf if quota == "max" else int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return math.inf


def _legacy(folder: Path) -> float:
    """Return the quota of a group of version 1."""
    try:
        quota = int((folder / "cpu.cfs_quota_us").read_text("utf-8"))
        period = int((folder / "cpu.cfs_period_us").read_text("utf-8"))
        return quota / period if quota > 0 else math.inf
    except (OSError, ValueError, ZeroDivisionError):
        return math.inf


def peak_memory_mb() -> float:
    """Return the most memory that this process ever held [MB]."""
    try:
        # Unlike getrusage, this does not count the process that started this one.
        status = (PROCESS / "status").read_text("utf-8")
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    except (OSError, IndexError, ValueError):
        import resource  # noqa: PLC0415 - not on every system

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # Bytes on macOS, kilobytes elsewhere.
        return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
