"""Functions on fixed memory, recorded as CUDA graphs of torch or of Warp."""

import gc
import warnings
from collections.abc import Callable
from typing import Any

import torch
import warp as wp

_WARM_UPS = 3


def recorded(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    """Record a function's kernels on a GPU, and return a function that replays them.

    The function is called a few times for warm-up and once for the recording. Each call
    must read and write the same memory, read nothing back to the host, and have results
    of the same shapes. A replay overwrites the results of the last one.

    Args:
        work: The function; it returns tensors, which are kept.
        device: Such as ``"cuda:0"``.

    Raises:
        RuntimeError: The function cannot be recorded.
    """
    with torch.cuda.device(device):
        side: Any = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(_WARM_UPS):
                work()
        torch.cuda.current_stream().wait_stream(side)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        collecting = gc.isenabled()
        # Memory that is freed during the recording would end it.
        gc.collect()
        gc.disable()
        try:
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                found = work()
        finally:
            if collecting:
                gc.enable()
        torch.cuda.synchronize()

    def replay() -> Any:
        graph.replay()
        return found

    return replay


def recorded_if_possible(
    name: str, work: Callable[[], Any], device: str
) -> Callable[[], Any]:
    """Return :func:`recorded`, or the function itself with a warning about the reason.

    Args:
        name: Name of the function in the warning.
        work: The function; see :func:`recorded`.
        device: Such as ``"cuda:0"``.
    """
    return _first(recorded, work, name, work, device)


def launched(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    """Record a function's launches in Warp, and return a function that replays them.

    The function is called once before the recording. The replay is on torch's current
    stream; on a CPU it is the function itself.

    Args:
        work: The function.
        device: Such as ``"cuda:0"``.

    Raises:
        RuntimeError: The function cannot be recorded.
    """
    with wp.ScopedDevice(device):
        if not device.startswith("cuda"):
            return _on_device(work, device)
        work()
        with wp.ScopedCapture() as capture:
            work()
        wp.synchronize()
        torch.cuda.synchronize()

    def replay() -> None:
        stream = wp.stream_from_torch(torch.cuda.current_stream(device))
        wp.capture_launch(capture.graph, stream=stream)

    return replay


def launched_if_possible(
    name: str, work: Callable[[], Any], device: str
) -> Callable[[], Any]:
    """Return :func:`launched`, or the function itself with a warning about the reason.

    Args:
        name: Name of the function in the warning.
        work: The function.
        device: Such as ``"cuda:0"``.
    """
    return _first(launched, _on_device(work, device), name, work, device)


def _on_device(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    def call() -> None:
        if not device.startswith("cuda"):
            with wp.ScopedDevice(device):
                work()
            return
        stream = wp.stream_from_torch(torch.cuda.current_stream(device))
        with wp.ScopedDevice(device), wp.ScopedStream(stream):
            work()

    return call


def _first(
    record: Callable[..., Callable[[], Any]],
    plain: Callable[[], Any],
    name: str,
    work: Callable[[], Any],
    device: str,
) -> Callable[[], Any]:
    """Return the recording, or the plain function with a warning about the reason."""
    try:
        return record(work, device)
    except (RuntimeError, AssertionError) as error:
        warnings.warn(
            f"No CUDA graph of {name}, which is slower: {type(error).__name__}: "
            f"{error}",
            RuntimeWarning,
            stacklevel=3,
        )
        if torch.cuda.is_available():
            torch.cuda.synchronize(device)
        return plain
