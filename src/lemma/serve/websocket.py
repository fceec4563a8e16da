"""Messages over a WebSocket, on the client side."""

import socket
import struct
from contextlib import ExitStack, suppress
from urllib.parse import urlsplit

from lemma.core.arguments import check_address_has_no_secret, secret_of
from lemma.core.errors import InvalidConfigError
from lemma.serve.conversation import Conversation, ProtocolMode, Remote, remote
from lemma.serve.faults import ProtocolError
from lemma.serve.messages import LARGEST_BYTES, websockets

SCHEMES = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
"""Valid schemes of an address, and their WebSocket schemes."""
AUTHORIZATION = "LEMMA_SERVER_AUTHORIZATION"
"""Environment variable with the value of the header ``Authorization``, for a server
behind a proxy: ``"Bearer ..."`` or ``"Basic ..."``."""
_CONNECT_S = 10.0
_SEND_S = 10
_CLOSE_S = 0.5


def is_address(name: str) -> bool:
    """Whether a policy's name is the address of a server."""
    scheme, colon, _ = name.partition("://")
    return bool(colon) and scheme.lower() in SCHEMES


def connect(url: str, mode: ProtocolMode) -> Remote:
    """Return the policy behind a socket.

    Args:
        url: Address such as ``"http://127.0.0.1:8000"``.
        mode: Time limits and retries.

    Raises:
        InvalidConfigError: The address is not valid, or the extra is not installed.
        PolicyUnreachableError: There was no connection in time.
        ProtocolError: The other side uses another protocol.
    """
    address = websocket_address(url)
    return remote(Conversation(url, lambda: WebSocketChannel(address), mode))


def websocket_address(url: str) -> str:
    """Return an address with the scheme of WebSockets.

    Raises:
        InvalidConfigError: It is not an address of a policy.
    """
    check_no_secret(url)
    try:
        parts = urlsplit(url)
        port_is_right = parts.port is None or parts.port > 0
    except ValueError:
        port_is_right = False
    if not port_is_right or parts.scheme not in SCHEMES or not parts.hostname:
        raise InvalidConfigError(
            f"{url!r} is not the address of a policy. Write it as in "
            "http://127.0.0.1:8000."
        )
    return parts._replace(scheme=SCHEMES[parts.scheme]).geturl()


def check_no_secret(url: str) -> None:
    """Check that an address contains no password.

    Raises:
        InvalidConfigError: It contains one.
    """
    advice = f"Put the value of an Authorization header into {AUTHORIZATION}."
    check_address_has_no_secret(url, "a policy", advice)


class WebSocketChannel:
    """A channel over one WebSocket connection."""

    def __init__(self, address: str) -> None:
        """Connect.

        Args:
            address: Address with the scheme ``ws`` or ``wss``.

        Raises:
            OSError: There is no answer, or no WebSocket.
            InvalidConfigError: The extra is not installed.
        """
        client = websockets("sync.client")
        header = secret_of(AUTHORIZATION)
        self._exceptions = websockets("exceptions")
        self._stack = ExitStack()
        try:
            # No pings: a slow policy is not dead, and decisions have their own limit.
            self._socket = self._stack.enter_context(
                client.connect(
                    address,
                    compression=None,
                    max_size=LARGEST_BYTES,
                    open_timeout=_CONNECT_S,
                    close_timeout=_CLOSE_S,
                    ping_interval=None,
                    proxy=None,
                    additional_headers={"Authorization": header} if header else None,
                )
            )
        except self._exceptions.WebSocketException as error:
            raise ConnectionError(str(error)) from error
        # Limit the wait for a server that does not read its messages.
        self._socket.socket.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", _SEND_S, 0)
        )

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises:
            OSError: The other side is gone.
            ProtocolError: The message is larger than the other side accepts.
        """
        if len(message) > LARGEST_BYTES:
            raise ProtocolError(
                f"A message of {len(message) >> 20} MiB is larger than the "
                f"{LARGEST_BYTES >> 20} MiB that policies accept. Use smaller images."
            )
        try:
            self._socket.send(message)
        except self._exceptions.ConnectionClosed as error:
            raise ConnectionError(str(error)) from error

    def receive(self, timeout_s: float) -> bytes | str:
        """Return the next message.

        Raises:
            TimeoutError: No message came in time.
            OSError: The other side is gone.
        """
        try:
            message: bytes | str = self._socket.recv(timeout=timeout_s)
            return message
        except self._exceptions.ConnectionClosed as error:
            raise ConnectionError(str(error)) from error

    def close(self) -> None:
        """Close the connection; never raises."""
        with suppress(Exception):
            self._stack.close()
