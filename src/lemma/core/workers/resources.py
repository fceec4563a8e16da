"""Cores and memory of this process."""

import math
import os
import sys
from pathlib import Path, PurePosixPath

PROCESS = Path("/proc/self")
CONTROL_GROUPS = Path("/sys/fs/cgroup")


def usable_cores() -> int:
    """Return the number of cores that this process may use.

    It is limited by the scheduler's affinity, and by a quota of processor time such as
    that of ``docker --cpus`` or Kubernetes, which is rounded up.
    """
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    return max(1, math.ceil(min(cores, _quota())))


def _quota() -> float:
    """Return the quota of this process's control groups, in cores."""
    try:
        lines = (PROCESS / "cgroup").read_text("utf-8").splitlines()
    except (OSError, ValueError):
        return math.inf
    quota = math.inf
    for line in lines:
        _, controllers, path = line.split(":", 2)
        group = PurePosixPath(path)
        # In a container, folders of the host are missing, so check each parent.
        for folder in (group, *group.parents):
            below = str(folder).lstrip("/")
            if controllers == "":
                quota = min(quota, _unified(CONTROL_GROUPS / below))
            elif "cpu" in controllers.split(","):
                quota = min(quota, _legacy(CONTROL_GROUPS / "cpu" / below))
    return quota


def _unified(folder: Path) -> float:
    """Return the quota of a control group of version 2, in cores."""
    try:
        quota, period = (folder / "cpu.max").read_text("utf-8").split()
        return math.inf if quota == "max" else int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return math.inf


def _legacy(folder: Path) -> float:
    """Return the quota of a control group of version 1, in cores."""
    try:
        quota = int((folder / "cpu.cfs_quota_us").read_text("utf-8"))
        period = int((folder / "cpu.cfs_period_us").read_text("utf-8"))
        return quota / period if quota > 0 else math.inf
    except (OSError, ValueError, ZeroDivisionError):
        return math.inf


def peak_memory_mb() -> float:
    """Return the peak memory of this process [MB]."""
    try:
        # Unlike getrusage, this excludes the memory of the parent before the fork.
        status = (PROCESS / "status").read_text("utf-8")
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    except (OSError, IndexError, ValueError):
        import resource  # noqa: PLC0415 - not on every system

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # The unit is bytes on macOS, kilobytes elsewhere.
        return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
