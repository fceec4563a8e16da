"""Description of this machine, for every measurement."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from lemma.core.errors import RenderingError
from lemma.core.version import VERSION as __version__
from lemma.core.workers.resources import usable_cores
from lemma.scene.rendering.gl_backend import choose_backend


def describe_machine() -> dict[str, Any]:
    """Return system, processor, memory, versions and renderer, ready for JSON."""
    try:
        backend = choose_backend()
        renderer = f"{backend.name}: {backend.renderer}"
    except RenderingError:
        renderer = "none"
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": usable_cores(),
        "memory_gb": _memory_gb(),
        "python": platform.python_version(),
        "lemma": __version__,
        "mujoco": installed_version("mujoco"),
        "renderer": renderer,
    }


def installed_version(package: str) -> str | None:
    """Return the version of a distribution, or None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1] for line in lines if line.startswith("model name")]
    return names[0].strip() if names else platform.machine()


def _memory_gb() -> float | None:
    try:
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return None
    return round(pages * size / 1e9, 1)
