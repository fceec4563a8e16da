"""The server of a policy behind a socket."""

import logging
import socket
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from queue import SimpleQueue
from typing import Any, Self

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError
from lemma.serve.messages import LARGEST_BYTES, websockets
from lemma.serve.session import ModelSession, Session

DEFAULT_PORT = 8000
PROTOCOLS = ("lemma", "vla-eval")
"""Protocols of a server: that of this package, and that of vla-eval's servers."""
_LOOK_S = 0.1
_HERE = "This is a LEMMA policy server. Speak WebSocket; see docs/serving.md.\n"
_OPEN_S = 10.0
_HEAD_BYTES = 65_536
_log = logging.getLogger("lemma.serve")
# Do not log connections that end before the handshake, such as load balancers' probes.
_log.addFilter(lambda record: "handshake failed" not in str(record.msg))


class RequestDispatcher:
    """Runs the requests of all clients in one thread, one after another.

    If a client disconnects while the policy computes its answer, the thread may hang.
    It is then abandoned and replaced by a new one.
    """

    def __init__(self) -> None:
        """Start the thread."""
        self._lock = threading.Lock()
        self._begin([])

    def call(self, work: Callable[[], Any], left: Callable[[], bool]) -> Any:
        """Run a function in the thread; return its result or raise its exception.

        Args:
            work: Function that calls the policy.
            left: Function that returns whether the client has disconnected.

        Raises:
            CancelledError: The client has disconnected.
        """
        future: Future[Any] = Future()
        with self._lock:
            self._queue.put((work, future))
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        while not done.wait(_LOOK_S):
            if left():
                self._give_up(future)
                raise CancelledError
        return future.result()

    def _give_up(self, future: "Future[Any]") -> None:
        with self._lock:
            if future.cancel() or future.done():
                return
            waiting = []
            while not self._queue.empty():
                waiting.append(self._queue.get())
            self._queue.put(None)
            self._begin(waiting)

    def _begin(self, waiting: list[Any]) -> None:
        self._queue: SimpleQueue[Any] = SimpleQueue()
        for item in waiting:
            self._queue.put(item)
        threading.Thread(target=_work, args=(self._queue,), daemon=True).start()

    def close(self) -> None:
        """Let the thread end after the present request."""
        with self._lock:
            self._queue.put(None)


def _work(queue: "SimpleQueue[Any]") -> None:
    while (item := queue.get()) is not None:
        work, future = item
        if not future.set_running_or_notify_cancel():
            continue
        try:
            result = work()
        except BaseException as error:
            # This includes SystemExit, so that clients of such a policy do not wait.
            if not isinstance(error, Exception):
                error = RuntimeError(f"{type(error).__name__}: {error}")
            future.set_exception(error)
        else:
            future.set_result(result)


class PolicyServer:
    """A server for a policy, which serves while its context is active.

    Many clients may send requests at a time; the policy gets one after another.
    """

    def __init__(
        self,
        policy: object,
        *,
        host: str = "127.0.0.1",
        port: int = DEFAULT_PORT,
        about: Mapping[str, Any] | None = None,
        protocol: str = PROTOCOLS[0],
    ) -> None:
        """Begin to listen.

        Args:
            policy: A policy; see :mod:`lemma.policies.interfaces`.
            host: Address to listen on. There is no password, so use only addresses of
                this machine or of a trusted network.
            port: Port to listen on; 0 for any free one.
            about: Description of the policy, ready for JSON; results contain it.
            protocol: One of :data:`PROTOCOLS`.

        Raises:
            ProtocolError: The policy has none of the protocol's methods.
            InvalidConfigError: The port is taken, or the extra is not installed; or the
                protocol cannot carry all inputs of the policy.
        """
        known("protocol", protocol, PROTOCOLS)
        self._session = Session if protocol == PROTOCOLS[0] else ModelSession
        self._session(policy, about)
        self._policy, self._about = policy, about
        self._desk = RequestDispatcher()
        self._connections: set[Any] = set()
        self._exceptions = websockets("exceptions")
        try:
            self._server = websockets("sync.server").serve(
                self._talk,
                host,
                port,
                compression=None,
                max_size=LARGEST_BYTES,
                ping_interval=None,
                process_request=_say_what_this_is,
                create_connection=_connection,
                open_timeout=_OPEN_S,
                logger=_log,
            )
        except (OSError, OverflowError) as error:
            raise InvalidConfigError(
                f"Cannot listen on {host}:{port}: {str(error).rstrip('.')}. "
                "Choose another port or address."
            ) from error
        self.host, self.port = host, int(self._server.socket.getsockname()[1])

    @property
    def url(self) -> str:
        """Address for clients."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}"

    def run(self) -> None:
        """Serve until :meth:`close` is called, or until Ctrl-C."""
        self._server.serve_forever()

    def close(self) -> None:
        """Close all connections."""
        self._server.shutdown()
        # Some versions of websockets do not close open connections.
        for connection in tuple(self._connections):
            connection.close_socket()
        self._desk.close()

    def __enter__(self) -> Self:
        """Serve in a thread."""
        threading.Thread(target=self.run, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        """Close all connections."""
        self.close()

    def _talk(self, connection: Any) -> None:
        """Serve one client until it disconnects."""

        def left() -> bool:
            return connection.close_code is not None or not _is_open(connection)

        session = self._session(
            self._policy, self._about, lambda work: self._desk.call(work, left)
        )
        self._connections.add(connection)
        try:
            while True:
                if answer := session.answer(connection.recv()):
                    connection.send(answer)
        except (CancelledError, self._exceptions.ConnectionClosed):
            pass
        finally:
            self._connections.discard(connection)


def serve(
    policy: object,
    *,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    about: Mapping[str, Any] | None = None,
    protocol: str = PROTOCOLS[0],
    on_ready: Callable[[str], object] = lambda url: None,
) -> None:
    """Serve a policy until Ctrl-C.

    Args:
        policy: A policy; see :mod:`lemma.policies.interfaces`.
        host: Address to listen on; there is no password.
        port: Port to listen on; 0 for any free one.
        about: Description of the policy, ready for JSON.
        protocol: One of :data:`PROTOCOLS`.
        on_ready: Called with the address once the server answers.

    Raises:
        ProtocolError: The policy has none of the protocol's methods.
        InvalidConfigError: The port is taken, the extra is not installed, or the
            protocol cannot carry all inputs of the policy.
    """
    server = PolicyServer(policy, host=host, port=port, about=about, protocol=protocol)
    with server:
        on_ready(server.url)
        with suppress(KeyboardInterrupt):
            threading.Event().wait()


def _is_open(connection: Any) -> bool:
    return str(connection.state.name) == "OPEN"


def _connection(sock: socket.socket, *args: Any, **options: Any) -> Any:
    """Return a connection; answer requests that websockets cannot read.

    Raises:
        ConnectionError: The request was answered here.
    """
    sock.settimeout(_OPEN_S)
    end = time.monotonic() + _OPEN_S
    head = sock.recv(_HEAD_BYTES, socket.MSG_PEEK)
    while head and b"\n" not in head and time.monotonic() < end:
        time.sleep(_LOOK_S)
        head = sock.recv(_HEAD_BYTES, socket.MSG_PEEK)
    line = head.partition(b"\n")[0].rstrip(b"\r").split(b" ")
    if line[0] == b"GET" and line[-1] == b"HTTP/1.1":
        sock.settimeout(None)
        return websockets("sync.server").ServerConnection(sock, *args, **options)
    status = "200 OK" if line[0] in (b"GET", b"HEAD") else "405 Method Not Allowed"
    if len(line) != 3 or not line[-1].startswith(b"HTTP/1."):
        status = "400 Bad Request"
    fields = [f"HTTP/1.1 {status}", "Allow: GET, HEAD", "Connection: close"]
    fields += ["Content-Type: text/plain", f"Content-Length: {len(_HERE)}", "", ""]
    body = "" if line[0] == b"HEAD" else _HERE
    if line[0]:
        # With unread bytes the system resets the connection before the answer arrives.
        sock.recv(_HEAD_BYTES)
        sock.sendall(("\r\n".join(fields) + body).encode())
        sock.shutdown(socket.SHUT_WR)
    raise ConnectionError("answered")


def _say_what_this_is(connection: Any, request: Any) -> Any:
    """Answer requests of browsers and health checks, which do not use WebSocket."""
    if request.headers.get("Upgrade", "").lower() == "websocket":
        return None
    return connection.respond(200, _HERE)
