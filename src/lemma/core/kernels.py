"""Kernels: plain loops that Numba compiles once and caches on disk.

Numba's own cache is valid until the kernel's file changes. But kernels also use kernels
and constants of other files; after a change there, the cached code would be outdated.
So the cache of this module depends on all sources that can be part of a kernel.

If several processes start at once, each kernel is compiled once, and one process prints
a message.
"""

import contextlib
import hashlib
import inspect
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, overload

from filelock import FileLock, Timeout
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.cgutils import get_null_value
from numba.extending import intrinsic

Function = TypeVar("Function", bound=Callable[..., Any])

SOURCES = ("core", "robots", "scene", "motion", "env/control")
"""Folders of the package whose kernels and constants other files may use in kernels."""

NOTICE = (
    "Compiling the numerical kernels for this machine, about half a minute. This "
    "happens once after each installation or update.\n"
)
"""Message to the error stream before the first compilation."""

_PACKAGE = Path(__file__).resolve().parents[1]
_TEMPORARY = ("/tmp", "/var/tmp", "/usr/tmp")
_PATIENCE_S = 120.0
"""Longest wait for another process that compiles; all kernels take a quarter of it."""


@overload
def kernel(function: Function, /) -> Function: ...


@overload
def kernel(*, nogil: bool) -> Callable[[Function], Function]: ...


def kernel(function: Any = None, /, *, nogil: bool = False) -> Any:
    """Compile a function at its first call, and cache the code on disk.

    Use plain loops over scalars and arrays, which give the same bits on every machine.
    Results of BLAS and of vectorised NumPy functions differ between CPUs.

    Args:
        function: Function to compile; it may call other kernels.
        nogil: Whether to release the GIL; for functions that take milliseconds.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(nogil=nogil, error_model="numpy")(function)
        kept: NullCache | _KernelCache
        try:
            kept = _KernelCache(function)
        except RuntimeError:
            # No folder is writable, so every start compiles; `lemma doctor` reports it.
            kept = _NoCache()
        dispatcher._cache = kept
        return dispatcher

    return compiled if function is None else compiled(function)


def _borrow(_: Any, array: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        found = context.make_array(array)(context, builder, values[0])
        found.meminfo = get_null_value(found.meminfo.type)
        return found._getvalue()

    return array(array), generate


borrowed: Any = intrinsic(_borrow)
"""In a kernel, returns an array without reference counting.

Numba counts references to every view with atomic instructions, which take longer than
most operations of kernels on a view. The caller of the kernel must keep the array
alive.
"""


def cache_folder(function: Callable[..., Any]) -> str | None:
    """Return the folder of a kernel's cached code, or None if it is not cached."""
    path: str | None = function.stats.cache_path  # type: ignore[attr-defined]
    return path


class _KernelCache(FunctionCache):
    """Cached code of one kernel: a file for every signature, and an index."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        tag = sys.implementation.cache_tag
        # No line number, so that moved code replaces its old file.
        name = f"{function.__module__}.{function.__qualname__}.{tag}"
        stamp = source_stamp(inspect.getfile(function))
        self._cache_file = IndexDataCacheFile(self.cache_path, name, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return cached code, or None; then Numba compiles and calls save_overload."""
        found = super().load_overload(sig, target_context)
        if found is None and _acquire():
            found = super().load_overload(sig, target_context)
            if found is not None:
                _release()
        # Compilation for further types takes a second and needs no message.
        if found is None and not self._cache_file._load_index():
            _announce()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store compiled code, and release the lock."""
        try:
            super().save_overload(sig, data)
        finally:
            _release()


class _NoCache(NullCache):
    """A cache without storage."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Print the message about compilation."""
        _announce()


@cache
def source_stamp(path: str) -> str:
    """Return a hash of all sources that the kernels of a file may use."""
    digest = hashlib.sha256(_shared_sources())
    digest.update(Path(path).read_bytes())
    return digest.hexdigest()


@cache
def _shared_sources() -> bytes:
    digest = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((_PACKAGE / folder).rglob("*.py")):
            source = path.read_bytes()
            digest.update(f"{path.relative_to(_PACKAGE)} {len(source)}\n".encode())
            digest.update(source)
    return digest.digest()


@cache
def _lock() -> FileLock | None:
    """Return the lock of all processes that compile this package's kernels.

    It is None without a folder for temporary files: Python would then use the current
    folder, where a user does not expect such files.
    """
    named = {os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")}
    try:
        folder = tempfile.gettempdir()
        if folder == str(Path.cwd()) and folder not in named | set(_TEMPORARY):
            return None
    except OSError:
        return None
    user = getattr(os, "getuid", int)()
    place = hashlib.sha256(f"{user} {_PACKAGE}".encode()).hexdigest()[:16]
    return FileLock(Path(folder) / f"lemma-kernels-{place}.lock")


def _acquire() -> bool:
    lock = _lock()
    # Without a lock, two processes may compile the same code, which is only slow.
    with contextlib.suppress(Timeout, OSError, NotImplementedError):
        if lock is not None:
            lock.acquire(timeout=_PATIENCE_S)
            return True
    return False


def _release() -> None:
    lock = _lock()
    if lock is not None:
        lock.release()


@cache
def _announce() -> None:
    """Print the message about compilation, unless another process just printed it."""
    lock = _lock()
    if lock is not None:
        said = Path(lock.lock_file).with_suffix(".said")
        with contextlib.suppress(OSError):
            if time.time() - said.stat().st_mtime < _PATIENCE_S:
                return
        with contextlib.suppress(OSError):
            said.touch()
    sys.stderr.write(NOTICE)
