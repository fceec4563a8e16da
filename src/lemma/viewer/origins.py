"""Guard of a page's socket against scripts of other pages in the same browser.

A browser lets every page open a socket to every address, this machine's too, and names
the page whose script it is in the header ``Origin``. The server has to check it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from ipaddress import ip_address
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server

_PATCHING = Lock()


@dataclass
class Guard:
    """Decides which sockets are opened by our own page, or by no page at all."""

    listens_at: str
    """Address of the server. On the loopback address it may be called by names of
    this machine alone, even if other names resolve to it."""
    hosts: frozenset[str] = frozenset()
    """Names by which a proxy may be called whose pages are ours, without ports."""
    tell: Callable[[str], None] = lambda _: None
    """Called with a sentence at the first refusal."""
    _refused: bool = field(default=False, init=False)

    def admits(self, origin: str | None, host: str | None) -> bool:
        """Return whether a socket may be opened.

        Args:
            origin: Page whose script opens it; None if no browser says so.
            host: Name and port by which the server was called.
        """
        if origin is None:
            return True
        page, called = urlsplit(origin), urlsplit(f"//{host or ''}")
        if page.hostname and page.hostname in self.hosts:
            return True
        if not host or page.netloc != host:
            return False
        return not _is_loopback(self.listens_at) or _is_loopback(called.hostname)

    def refuse(self, origin: str | None, host: str | None) -> None:
        """Say on the terminal that a socket was refused, the first time."""
        if not self._refused:
            self._refused = True
            self.tell(
                f"A page of {origin} was refused; it called this server {host}. Behind "
                "a proxy, name the host in the browser's address bar: --allow-host HOST"
            )


def _is_loopback(name: str | None) -> bool:
    try:
        return name == "localhost" or ip_address(name or "").is_loopback
    except ValueError:
        return False


@contextmanager
def guarded_by(guard: Guard) -> Iterator[None]:
    """Let servers that are started meanwhile ask a guard before they open a socket.

    viser has no option for it, and starts its server by this function.
    """
    library: Any = websockets.asyncio.server
    with _PATCHING:
        start = library.serve
        library.serve = partial(_serve, start, guard)
        try:
            yield
        finally:
            library.serve = start


def _serve(
    start: Callable[..., Any],
    guard: Guard,
    *arguments: Any,
    process_request: Callable[[Any, Any], Any],
    **options: Any,
) -> Any:
    def check(connection: Any, request: Any) -> Any:
        origin, host = (request.headers.get(name) for name in ("Origin", "Host"))
        wants_socket = request.headers.get("Upgrade", "").lower() == "websocket"
        if wants_socket and not guard.admits(origin, host):
            guard.refuse(origin, host)
            return connection.respond(HTTPStatus.FORBIDDEN, "Not from another page.\n")
        return process_request(connection, request)

    return start(*arguments, process_request=check, **options)
