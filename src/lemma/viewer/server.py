"""Servers of pages: address, guard, looks, and loop."""

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import viser

from lemma.core.errors import InvalidConfigError
from lemma.viewer.origins import Guard, guarded_by

UPDATES_HZ = 25.0
"""How often a scene is moved on its page."""


PHONE_PANEL = 0.52
"""Share of the height that the panel covers at most in a narrow window."""
NOTICE_STYLE = """<style>
#webgl-software-rendering { animation: leave 1s 5s forwards; }
#webgl-software-rendering .mantine-Notification-description { display: none; }
@keyframes leave { to { opacity: 0; visibility: hidden; } }
</style>"""
"""The library's notice of software WebGL is one line, and leaves by itself."""
_PHONE_STYLE = f"""<style>
@media (max-width: 36em) {{
  .mantine-Paper-root:has(#lemma-style) {{
    width: 100% !important; max-height: {PHONE_PANEL:.0%} !important;
  }}
  .mantine-Paper-root:has(#lemma-style) div:has(#lemma-style) {{
    width: 100% !important; min-width: 0 !important;
  }}
}}
</style>"""


class _Server(viser.ViserServer):
    """A server without a tunnel to the internet."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: visitors cannot open a tunnel."""


def open_server(
    host: str,
    port: int,
    hosts: Iterable[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> viser.ViserServer:
    """Listen.

    Args:
        host: Address to listen on.
        port: Port to listen on; the next one that is free if it is taken.
        hosts: Names by which a proxy may be called.
        tell: Called with a sentence when a socket is refused for the first time.

    Raises:
        InvalidConfigError: That is no address of this machine, or no port.
    """
    check_address(host, port)
    guard = Guard(host, frozenset(name.lower() for name in hosts), tell)
    # The library would print an address, too.
    with contextlib.redirect_stdout(io.StringIO()), guarded_by(guard):
        return _Server(host, port, label="LEMMA Bench", verbose=False)


def address_of(host: str, port: int) -> str:
    """Return the address to visit on this machine: IPv6 stands in brackets."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def prepare_panel(server: viser.ViserServer) -> None:
    """Lay the panel at the right, or below the scene in a narrow window."""
    set_theme(server.gui, dark=False)
    server.gui.main_panel.dock_right()
    server.gui.add_html(f'<div id="lemma-style">{NOTICE_STYLE}{_PHONE_STYLE}</div>')


def set_theme(gui: Any, *, dark: bool) -> None:
    """Set how a page looks."""
    gui.configure_theme(
        dark_mode=dark,
        control_width="large",
        show_logo=False,
        show_share_button=False,
        brand_color=(34, 110, 190),
    )


def close_server(server: viser.ViserServer) -> None:
    """Stop listening, and print nothing."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class Rounds:
    """Calls a function :data:`UPDATES_HZ` times a second until it is ended."""

    def __init__(self) -> None:
        """Prepare the loop."""
        self._over, self._turn = threading.Event(), threading.Lock()

    def go(self, tick: Callable[[float], None]) -> None:
        """Go round until it is ended.

        Args:
            tick: Called with the real time since the last call [s].
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
        """End it; the present call is waited for."""
        self._over.set()
        with self._turn:
            pass


def check_address(host: str, port: int) -> None:
    """Check that a server can listen there.

    Raises:
        InvalidConfigError: That is no address of this machine, or no port.
    """
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
