"""Other people's policies, each in a process of its own.

A thread that hangs cannot be ended, and a library that crashes takes its process along;
a process of its own can be killed and begun again, whatever its policy does.
"""

import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from os import _exit
from typing import Any

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.plugins import load_plugins
from lemma.policies.class_path import instance_of
from lemma.serve.client.conversation import Conversation, ProtocolMode
from lemma.serve.client.remote import Remote, remote
from lemma.serve.protocol.messages import PROTOCOL, Error, Hello, decode_reply, encode
from lemma.serve.server.session import Session

_START_S = 300.0
_END_S = 1.0


def isolate(
    name: str, timeout_s: float, arguments: Mapping[str, Any] | None = None
) -> Remote:
    """Return a policy that lives in another process, which this one may kill.

    Args:
        name: Of its class, ``"package.module:Class"``.
        timeout_s: For one decision [s].
        arguments: That it is called with, by name.

    Raises:
        InvalidConfigError: There is no such class, or it cannot be made.
    """
    mode = ProtocolMode(timeout_s, patience_s=0.0, first_patience_s=0.0, deaths=1)
    return remote(Conversation(name, lambda: ProcessChannel(name, arguments), mode))


class ProcessChannel:
    """A process with a policy, and the pipe to it."""

    def __init__(self, name: str, arguments: Mapping[str, Any] | None = None) -> None:
        """Start the process and wait until its policy is there.

        Args:
            name: Of the policy's class.
            arguments: That it is called with, by name.

        Raises:
            OSError: It died, or takes too long.
            InvalidConfigError: There is no such class, or it cannot be made.
        """
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=host,
            args=(theirs, name, arguments),
            daemon=True,
            name=f"policy {name}",
        )
        self._process.start()
        theirs.close()
        try:
            ready = decode_reply(self.receive(_START_S))
        except OSError:
            self.close()
            raise
        if isinstance(ready, Error):
            self.close()
            raise InvalidConfigError(ready.message)

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises:
            OSError: The process is gone.
        """
        self._pipe.send_bytes(message)

    def receive(self, timeout_s: float) -> bytes:
        """Return the next message.

        Raises:
            TimeoutError: There is none in time.
            OSError: The process is gone.
        """
        if not self._pipe.poll(timeout_s):
            raise TimeoutError
        try:
            return self._pipe.recv_bytes()
        except EOFError as error:
            self._process.join(_END_S)
            raise ConnectionError(
                f"its process ended with {_why(self._process.exitcode)}"
            ) from error

    def close(self) -> None:
        """Kill the process; never raises."""
        with suppress(Exception):
            self._process.kill()
            self._process.join(_END_S)
            self._pipe.close()


def host(
    pipe: "Connection[Any, Any]", name: str, arguments: Mapping[str, Any] | None
) -> None:
    """Make a policy and answer for it until nobody asks any more.

    Args:
        pipe: To whoever asks.
        name: Of the policy's class.
        arguments: That it is called with, by name.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        load_plugins()
        session = Session(instance_of(name, arguments))
    except LemmaError as error:
        pipe.send_bytes(encode(Error(kind="request", message=str(error))))
        return
    _use_one_core()
    # It is ready: the answer to a greeting that nobody sent.
    pipe.send_bytes(session.answer(encode(Hello(protocol=PROTOCOL))))
    with suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            pipe.send_bytes(session.answer(pipe.recv_bytes()))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    _exit(1)


def _use_one_core() -> None:
    """Keep torch, if the policy uses it, from fighting the other workers for cores."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def _why(code: int | None) -> str:
    if code is None:
        return "no exit code"
    return f"signal {-code}" if code < 0 else f"exit code {code}"
