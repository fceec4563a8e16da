"""Who may speak to a page: scripts of other pages in the same browser may not.

A browser lets every page open a socket to every address, this machine's too, and says
in a header whose script it is. Nothing checks that but the server.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from ipaddress import ip_address
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server

_PATCHING = Lock()


def is_own(origin: str | None, host: str | None, listens_at: str) -> bool:
    """Return whether a socket is opened by a page of ours, or by no page at all.

    Args:
        origin: Whose script opens it; None if no browser says so.
        host: By which name and port we were called.
        listens_at: Address that we listen on. On the loopback address nobody calls us
            by a name of theirs, whatever that name resolves to.
    """
    if origin is None:
        return True
    if not host or urlsplit(origin).netloc != host:
        return False
    return not _is_loopback(listens_at) or _is_loopback(urlsplit(f"//{host}").hostname)


def _is_loopback(name: str | None) -> bool:
    try:
        return name == "localhost" or ip_address(name or "").is_loopback
    except ValueError:
        return False


@contextmanager
def only_own(listens_at: str) -> Iterator[None]:
    """Let servers that are started meanwhile refuse sockets of other pages.

    viser has no option for it, and starts its server by this function.

    Args:
        listens_at: Address that they listen on.
    """
    library: Any = websockets.asyncio.server
    with _PATCHING:
        start = library.serve
        library.serve = partial(_serve, start, listens_at)
        try:
            yield
        finally:
            library.serve = start


def _serve(
    start: Callable[..., Any],
    listens_at: str,
    *arguments: Any,
    process_request: Callable[[Any, Any], Any],
    **options: Any,
) -> Any:
    def check(connection: Any, request: Any) -> Any:
        origin, host = (request.headers.get(name) for name in ("Origin", "Host"))
        wants_socket = request.headers.get("Upgrade", "").lower() == "websocket"
        if wants_socket and not is_own(origin, host, listens_at):
            return connection.respond(HTTPStatus.FORBIDDEN, "Not from another page.\n")
        return process_request(connection, request)

    return start(*arguments, process_request=check, **options)
