"""Servers of pages: address, check of origins, theme, and loop.

A browser lets any page open a socket to any address, including this machine's. It sends
the page's address in the header ``Origin``. The guard checks this header, so scripts of
other pages in the same browser cannot connect.
"""

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server

from lemma.core.arguments import is_loopback
from lemma.core.errors import InvalidConfigError
from lemma.viz.pages.templates import macro

UPDATES_HZ = 25.0
"""Updates of a page's scene per second."""


PHONE_PANEL = 0.52
"""Largest share of the height that the panel covers in a narrow window."""
_PATCHING = threading.Lock()


class _Server(viser.ViserServer):
    """A server without a tunnel to the internet."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing, so that visitors cannot open a tunnel."""


@dataclass
class Guard:
    """Accepts sockets of the server's own page and of programs other than browsers."""

    listens_at: str
    """Address of the server. On the loopback address only names of this machine are
    accepted, even if other names resolve to it."""
    hosts: Collection[str] = ()
    """Allowed host names of a proxy, without ports."""
    tell: Callable[[str], None] = lambda _: None
    """Called with a sentence at the first refusal."""
    _refused: bool = field(default=False, init=False)

    def admits(self, origin: str | None, host: str | None) -> bool:
        """Return whether a socket may be opened; report the first refusal.

        Args:
            origin: The header ``Origin``; None if it is missing.
            host: The header ``Host``: name and port of the called server.
        """
        if origin is None:
            return True
        page, called = urlsplit(origin), urlsplit(f"//{host or ''}")
        if page.hostname and page.hostname in map(str.lower, self.hosts):
            return True
        local = is_loopback(called.hostname) or not is_loopback(self.listens_at)
        if host and page.netloc == host and local:
            return True
        if not self._refused:
            self._refused = True
            self.tell(
                f"A page of {origin} was refused; it called this server {host}. Behind "
                "a proxy, allow the host in the browser's address bar: --allow-host "
                "HOST"
            )
        return False


@contextlib.contextmanager
def _guarded_by(guard: Guard) -> Iterator[None]:
    """Make servers that start in the body check sockets with a guard.

    viser has no option for it, so the function that starts its server is replaced.
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
    """Start a server.

    Args:
        host: Address to listen on.
        port: Port to listen on; if it is taken, the next free one.
        hosts: Allowed host names of a proxy.
        tell: Called with a sentence at the first refused socket.

    Raises:
        InvalidConfigError: The address or port is not valid on this machine.
    """
    check_address(host, port)
    guard = Guard(host, hosts, tell)
    # viser would print an address as well.
    with contextlib.redirect_stdout(io.StringIO()), _guarded_by(guard):
        return _Server(host, port, label="LEMMA Bench", verbose=False)


def address_of(host: str, port: int) -> str:
    """Return the URL for this machine; an IPv6 address is put in brackets."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def prepare_panel(server: viser.ViserServer) -> None:
    """Put the panel at the right, or below the scene in a narrow window."""
    set_theme(server.gui, dark=False)
    server.gui.main_panel.dock_right()
    server.gui.add_html(macro("panel.html", "style", PHONE_PANEL))


def set_theme(gui: Any, *, dark: bool) -> None:
    """Set the theme of a page."""
    gui.configure_theme(
        dark_mode=dark,
        control_width="large",
        show_logo=False,
        show_share_button=False,
        brand_color=(34, 110, 190),
    )


def close_server(server: viser.ViserServer) -> None:
    """Stop a server without output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class Rounds:
    """Calls a function :data:`UPDATES_HZ` times a second until it is ended."""

    def __init__(self) -> None:
        """Prepare the loop."""
        self._over, self._turn = threading.Event(), threading.Lock()

    def go(self, tick: Callable[[float], None]) -> None:
        """Run the loop until :meth:`end`.

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
        """End the loop after the present call."""
        self._over.set()
        with self._turn:
            pass


def check_address(host: str, port: int) -> None:
    """Check that a server can listen there.

    Raises:
        InvalidConfigError: The address or port is not valid on this machine.
    """
    if not 0 < port < 65536:
        raise InvalidConfigError(f"{port} is not a port. Valid: 1 to 65535.")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.bind((host, 0))
    except OSError as error:
        raise InvalidConfigError(
            f"This machine cannot listen on {host!r}: {error}. Valid: 127.0.0.1, or "
            "0.0.0.0 for everybody who reaches it."
        ) from None
