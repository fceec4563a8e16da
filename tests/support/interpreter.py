"""A new interpreter, for tests of what one that runs already cannot show."""

import os
import subprocess
import sys
from collections.abc import Collection, Mapping
from pathlib import Path


def python(
    *words: object,
    folder: Path | None = None,
    variables: Mapping[str, str] | None = None,
) -> "subprocess.CompletedProcess[str]":
    """Run Python with some words in a folder, and return how that ended."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env={**os.environ, **(variables or {})},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def told_without(packages: Collection[str], code: str) -> str:
    """Return what code prints where packages cannot be imported; it may not warn."""
    missing = f"import sys\nsys.modules.update(dict.fromkeys({packages!r}))\n"
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = python("-W", "error", "-c", missing + code, variables=path)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout
