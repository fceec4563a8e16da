"""The page: a server, a session, a panel, and the loop that keeps them in step."""

import contextlib
import io
import socket
import threading
import time

import viser

from lemma.core.errors import InvalidConfigError
from lemma.viewer.panel import Panel, set_theme
from lemma.viewer.pictures import Pictures
from lemma.viewer.play import Play
from lemma.viewer.session import Session
from lemma.viewer.stage import Stage

UPDATES_HZ = 25.0
"""How often the scene is moved on the page."""
_LOOK_AT_FIRST = {"names"}


class _Server(viser.ViserServer):
    """A server that nobody opens to the world: there is no tunnel."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing, whoever asks."""


class Page:
    """A page on an address; all of its tabs see the same."""

    def __init__(self, session: Session, host: str, port: int) -> None:
        """Listen.

        Args:
            session: What is shown; closed with the page.
            host: Address to listen on.
            port: Port to listen on; the next one that is free if it is taken.

        Raises:
            InvalidConfigError: That is no address of this machine, or no port.
        """
        _check_address(host, port)
        self.session = session
        # It would announce itself, and we do that.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = _Server(host, port, label="LEMMA Bench", verbose=False)
        set_theme(self._server.gui, dark=False)
        self._server.gui.main_panel.dock_right()
        self.port = self._server.get_port()
        self.address = f"http://{host}:{self.port}"
        self.stage = Stage(self._server, _LOOK_AT_FIRST)
        self.panel = Panel(
            self._server, session, _LOOK_AT_FIRST, self.stage.set_visible
        )
        self.pictures = Pictures(self.panel.show_picture)
        self._shown: Play | None = None
        self._closed = threading.Event()
        self.updates = 0
        """How often the loop has gone round."""

    def tick(self, real_s: float) -> None:
        """Move on by some real time [s], and show it."""
        play = self.session.play
        play.transport.advance(real_s)
        qpos = play.transport.qpos()
        if play.scene is not None and play.instance is not None and qpos is not None:
            if play is not self._shown:
                self.stage.set_scene(play.scene, play.instance)
                self._shown = play
            self.stage.step_back()
            self.stage.show(qpos)
            self.pictures.want(self.panel.picture.value, play.instance, qpos)
        self.panel.refresh(play)
        self.updates += 1

    def run(self) -> None:
        """Go on until it is closed from another thread, or interrupted."""
        period, last = 1.0 / UPDATES_HZ, time.perf_counter()
        while not self._closed.is_set():
            now = time.perf_counter()
            self.tick(now - last)
            last = now
            self._closed.wait(max(0.0, period - (time.perf_counter() - now)))

    def close(self) -> None:
        """Stop listening, and free what was held."""
        self._closed.set()
        self.session.close()
        self.pictures.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()


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
