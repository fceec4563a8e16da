"""Servers of pages: address, guard, looks, and loop.

A browser lets every page open a socket to every address, this machine's too, and names
the page whose script it is in the header ``Origin``. The guard checks it, so that
scripts of other pages in the same browser open no socket.
"""

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server

from lemma.core.errors import InvalidConfigError
from lemma.viz.pages.templates import macro

UPDATES_HZ = 25.0
"""How often a scene is moved on its page."""


PHONE_PANEL = 0.52
"""Share of the height that the panel covers at most in a narrow window."""
_PATCHING = threading.Lock()


class _Server(viser.ViserServer):
    """A server without a tunnel to the internet."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: visitors cannot open a tunnel."""


@dataclass
class Guard:
    """Decides which sockets are opened by our own page, or by no page at all."""

    listens_at: str
    """Address of the server. On the loopback address it may be called by names of
    this machine alone, even if other names resolve to it."""
    hosts: Collection[str] = ()
    """Names by which a proxy may be called whose pages are ours, without ports."""
    tell: Callable[[str], None] = lambda _: None
    """Called with a sentence at the first refusal."""
    _refused: bool = field(default=False, init=False)

    def admits(self, origin: str | None, host: str | None) -> bool:
        """Return whether a socket may be opened; the first refusal is told.

        Args:
            origin: Page whose script opens it; None if no browser says so.
            host: Name and port by which the server was called.
        """
        if origin is None:
            return True
        page, called = urlsplit(origin), urlsplit(f"//{host or ''}")
        if page.hostname and page.hostname in map(str.lower, self.hosts):
            return True
        local = _is_loopback(called.hostname) or not _is_loopback(self.listens_at)
        if host and page.netloc == host and local:
            return True
        if not self._refused:
            self._refused = True
            self.tell(
                f"A page of {origin} was refused; it called this server {host}. Behind "
                "a proxy, name the host in the browser's address bar: --allow-host HOST"
            )
        return False


def _is_loopback(name: str | None) -> bool:
    try:
        return name == "localhost" or ip_address(name or "").is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def _guarded_by(guard: Guard) -> Iterator[None]:
    """Let servers that are started meanwhile ask a guard before they open a socket.

    viser has no option for it, and starts its server by this function.
    """
    library: Any = websockets.asyncio.server

    def serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            origin, host = (request.headers.get(name) for name in ("Origin", "Host"))
            wants_socket = request.headers.get("Upgrade", "").lower() == "websocket"
            if wants_socket and not guard.admits(origin, host):
                words = "Not from another page.\n"
                return connection.respond(HTTPStatus.FORBIDDEN, words)
            return process_request(connection, request)

        return start(*arguments, process_request=check, **options)

    with _PATCHING:
        start = library.serve
        library.serve = serve
        try:
            yield
        finally:
            library.serve = start


def open_server(
    host: str,
    port: int,
    hosts: Collection[str] = (),
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
    guard = Guard(host, hosts, tell)
    # The library would print an address, too.
    with contextlib.redirect_stdout(io.StringIO()), _guarded_by(guard):
        return _Server(host, port, label="LEMMA Bench", verbose=False)


def address_of(host: str, port: int) -> str:
    """Return the address to visit on this machine: IPv6 stands in brackets."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def prepare_panel(server: viser.ViserServer) -> None:
    """Lay the panel at the right, or below the scene in a narrow window."""
    set_theme(server.gui, dark=False)
    server.gui.main_panel.dock_right()
    server.gui.add_html(macro("panel.html", "style", PHONE_PANEL))


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
