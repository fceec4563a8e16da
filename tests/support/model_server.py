"""A model server of vla-eval, as its own are seen from outside: version 1, by msgpack.

Nothing of this package is used, so that both sides cannot err alike.
"""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import msgpack
import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

Predict = Callable[[dict[str, Any], int], Any]
"""Returns the payload of the answer to an observation and its number in the episode. An
exception is answered as servers of vla-eval do; ``bytes`` are sent as they are."""

HELLO = {
    "harness_version": "0.8.0",
    "protocol_version": 1,
    "model_server": "Stub",
    "capabilities": {},
}


def array(value: Any) -> Any:
    """Return arrays as vla-eval sends them."""
    if isinstance(value, np.ndarray):
        return {
            "__ndarray__": True,
            "data": value.tobytes(),
            "dtype": value.dtype.str,
            "shape": list(value.shape),
        }
    return value


def read_array(sent: dict[str, Any]) -> Any:
    """Return what :func:`array` wrote."""
    if "__ndarray__" not in sent:
        return sent
    return np.frombuffer(sent["data"], np.dtype(sent["dtype"])).reshape(sent["shape"])


def pack(kind: str, payload: Any, seq: int) -> bytes:
    """Return a message."""
    raw = {"type": kind, "payload": payload, "seq": seq, "timestamp": time.time()}
    found: bytes = msgpack.packb(raw, default=array, use_bin_type=True)
    return found


def unpack(data: Any) -> dict[str, Any]:
    """Return what :func:`pack` wrote."""
    found: dict[str, Any] = msgpack.unpackb(data, object_hook=read_array, raw=False)
    return found


def wait_for(log: list[dict[str, Any]], kind: str, count: int) -> None:
    """Wait until so many messages of a kind have come in; nobody answers some."""
    end = time.monotonic() + 10.0
    while sum(message["type"] == kind for message in log) < count:
        assert time.monotonic() < end, f"no {count} messages of kind {kind}"
        time.sleep(0.01)


@contextmanager
def model_server(
    predict: Predict,
    hello: dict[str, Any] = HELLO,
    on_start: Callable[[dict[str, Any]], object] = lambda payload: None,
    log: list[dict[str, Any]] | None = None,
) -> Iterator[str]:
    """Run a server; yields its address.

    Args:
        predict: Answers observations.
        hello: Its description of itself.
        on_start: Told of every episode.
        log: Gets every message that comes in.
    """
    said = [] if log is None else log

    def answer(connection: Any, message: dict[str, Any], step: int) -> None:
        try:
            payload = predict(message["payload"], step)
        except Exception as error:
            text = f"observation_failed: {type(error).__name__}: {error}"
            connection.send(pack("error", {"error": text}, message["seq"]))
        else:
            if payload is not None:
                frame = payload
                if not isinstance(payload, bytes):
                    frame = pack("action", payload, message["seq"])
                connection.send(frame)

    connections = []

    def talk(connection: Any) -> None:
        connections.append(connection)
        step = 0
        with suppress(ConnectionClosed):
            for frame in connection:
                message = unpack(frame)
                said.append(message)
                if message["type"] == "hello":
                    connection.send(pack("hello", hello, message["seq"]))
                elif message["type"] == "episode_start":
                    step = 0
                    try:
                        on_start(message["payload"])
                    except Exception as error:
                        text = f"episode_start_failed: {type(error).__name__}: {error}"
                        connection.send(pack("error", {"error": text}, message["seq"]))
                elif message["type"] == "observation":
                    answer(connection, message, step)
                    step += 1

    with serve(talk, "127.0.0.1", 0, compression=None, max_size=None) as own:
        thread = threading.Thread(target=own.serve_forever)
        thread.start()
        try:
            yield f"vla-eval://127.0.0.1:{own.socket.getsockname()[1]}"
        finally:
            own.shutdown()
            thread.join()
            # Those that are being talked on outlive the server, and clients would not
            # see that it is gone.
            for connection in connections:
                with suppress(OSError):
                    connection.socket.shutdown(socket.SHUT_RDWR)
