"""Functions of fixed memory, recorded as CUDA graphs of torch or of Warp."""

import gc
import warnings
from collections.abc import Callable
from typing import Any

import torch
import warp as wp

_WARM_UPS = 3


def recorded(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    """Record what a function launches on a GPU, and return what replays it.

    The function is called a few times, once of which is recorded: it reads and writes
    the same memory at each call, reads nothing back to the host, and its results have
    the same shapes. The results of a replay are overwritten by
    the next one.

    Args:
        work: The function; tensors in what it returns are kept.
        device: Such as ``"cuda:0"``.

    Raises:
        RuntimeError: Something in it cannot be recorded.
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
        # Memory that is given back meanwhile would end the recording.
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
    """Return :func:`recorded`, or the function itself with a warning that says why.

    Args:
        name: For the warning.
        work: As there.
        device: As there.
    """
    return _first(recorded, work, name, work, device)


def launched(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    """Record what a function launches in Warp, and return what replays it.

    It is called once before. The replay is on the current stream of torch; on a CPU it
    is the function itself.

    Args:
        work: The function.
        device: Such as ``"cuda:0"``.

    Raises:
        RuntimeError: Something in it cannot be recorded.
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
    """Return :func:`launched`, or what calls the function, with a warning.

    Args:
        name: For the warning.
        work: As there.
        device: As there.
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
    """Return what was recorded, or something plain with a warning that says why."""
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
