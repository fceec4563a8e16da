"""Servers of pages: on an address that is checked, without a tunnel or a word."""

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable

import viser

from lemma.core.errors import InvalidConfigError
from lemma.viewer.origins import only_own

UPDATES_HZ = 25.0
"""How often a scene is moved on its page."""


class _Server(viser.ViserServer):
    """A server that nobody opens to the world: there is no tunnel."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing, whoever asks."""


def open_server(host: str, port: int) -> viser.ViserServer:
    """Listen.

    Args:
        host: Address to listen on.
        port: Port to listen on; the next one that is free if it is taken.

    Raises:
        InvalidConfigError: That is no address of this machine, or no port.
    """
    _check_address(host, port)
    # It would announce itself, and we do that.
    with contextlib.redirect_stdout(io.StringIO()), only_own(host):
        return _Server(host, port, label="LEMMA Bench", verbose=False)


def close_server(server: viser.ViserServer) -> None:
    """Stop listening, without a word."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class Rounds:
    """Calls something :data:`UPDATES_HZ` times a second, until somebody ends it."""

    def __init__(self) -> None:
        """Begin with none."""
        self._over, self._turn = threading.Event(), threading.Lock()

    def go(self, tick: Callable[[float], None]) -> None:
        """Go round until it is ended.

        Args:
            tick: Told how much real time has passed since the last time [s].
        """
        period, last = 1.0 / UPDATES_HZ, time.perf_counter()
        while True:
            with self._turn:
                if self._over.is_set():
                    return
                now = time.perf_counter()
                tick(now - last)
                last = now
            self._over.wait(max(0.0, period - (time.perf_counter() - now)))

    def end(self) -> None:
        """End it; what is called now has come to its end then."""
        self._over.set()
        with self._turn:
            pass


def _check_address(host: str, port: int) -> None:
    """Check what the server would wait for without a word."""
    if not 0 < port < 65536:
        raise InvalidConfigError(f"{port} is no port. Valid: 1 to 65535.")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.bind((host, 0))
    except OSError as error:
        raise InvalidConfigError(
            f"This machine cannot listen on {host!r}: {error}. Valid: 127.0.0.1, or "
            "0.0.0.0 for everybody who reaches it."
        ) from None
