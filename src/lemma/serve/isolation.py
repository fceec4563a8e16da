"""Isolation of user-defined policies, each in its own process.

A thread that hangs cannot be ended, and a library that crashes ends its process. A
separate process can be killed and started again in both cases. It leads its own process
group, so processes that a policy starts end with it.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from typing import Any

from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.core.plugins import load_plugins
from lemma.policies.class_path import instance_of
from lemma.serve import messages
from lemma.serve.conversation import Conversation, ProtocolMode, Remote, remote
from lemma.serve.faults import PolicyUnreachableError
from lemma.serve.session import Session

_START_S = 300.0
_END_S = 1.0
_LOOK_S = 1.0


def isolate(
    name: str, timeout_s: float, arguments: Mapping[str, Any] | None = None
) -> Remote:
    """Start a policy in another process, and return a client for it.

    Args:
        name: Name of its class, ``"package.module:Class"``.
        timeout_s: Time limit for one decision [s].
        arguments: Keyword arguments of the class.

    Raises:
        InvalidConfigError: There is no such class, or its construction fails.
    """
    mode = ProtocolMode(timeout_s, patience_s=0.0, first_patience_s=0.0, deaths=1)
    return remote(Conversation(name, lambda: ProcessChannel(name, arguments), mode))


class ProcessChannel:
    """A channel to a policy in a child process: the process and a pipe to it."""

    def __init__(self, name: str, arguments: Mapping[str, Any] | None = None) -> None:
        """Start the process, and wait until its policy is constructed.

        Args:
            name: Name of the policy's class.
            arguments: Keyword arguments of the class.

        Raises:
            PolicyUnreachableError: The process ended, or takes too long.
            InvalidConfigError: There is no such class, or its construction fails.
        """
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        # A daemon ends with this process; "host" then allows it to have children.
        self._process = context.Process(
            target=host,
            args=(theirs, name, arguments),
            daemon=True,
            name=f"policy {name}",
        )
        try:
            self._process.start()
            theirs.close()
            # A finalizer also runs in workers, which call no "atexit" functions.
            self._kill = Finalize(self, _kill, (self._process,), exitpriority=100)
            ready = messages.decode_reply(self.receive(_START_S))
        except OSError as error:
            self.close()
            raise PolicyUnreachableError(
                f"The process of the policy {name} could not start: "
                f"{error or f'it took more than {_START_S:g} s'}. See its output for "
                "the reason. The process imports the main program again: save the "
                "program in a file, and put its actions under "
                "'if __name__ == \"__main__\":'."
            ) from error
        if isinstance(ready, messages.Error):
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
            TimeoutError: No message came in time.
            OSError: The process is gone.
            PolicyUnreachableError: The system has killed the process.
        """
        end = time.monotonic() + timeout_s
        # Children of a dead process may keep its end of the pipe open.
        while not self._pipe.poll(min(_LOOK_S, max(0.0, end - time.monotonic()))):
            if not (self._process.is_alive() or self._pipe.poll()):
                raise self._ended()
            if time.monotonic() >= end:
                raise TimeoutError
        try:
            return self._pipe.recv_bytes()
        except EOFError:
            self._process.join(_END_S)
            raise self._ended() from None

    def _ended(self) -> Exception:
        code = self._process.exitcode
        if code == -signal.SIGKILL:
            return PolicyUnreachableError(
                "The process of the policy was killed, probably because the system ran "
                "out of memory. Free memory, or use fewer workers; the same command "
                "then continues."
            )
        why = "no exit code" if code is None else f"exit code {code}"
        if code is not None and code < 0:
            why = f"signal {-code}"
        return ConnectionError(f"its process ended with {why}")

    def close(self) -> None:
        """Kill the process; never raises."""
        with suppress(Exception):
            self._kill()
            self._process.join(_END_S)
            self._pipe.close()


def _kill(process: BaseProcess) -> None:
    """Kill a process and the processes that it started; never raises."""
    with suppress(Exception):
        if process.pid is not None:
            os.killpg(process.pid, signal.SIGKILL)
    with suppress(Exception):
        process.kill()


def host(
    pipe: "Connection[Any, Any]", name: str, arguments: Mapping[str, Any] | None
) -> None:
    """Construct a policy, and answer requests until the pipe is closed.

    Args:
        pipe: Pipe to the parent process.
        name: Name of the policy's class.
        arguments: Keyword arguments of the class.
    """
    with suppress(AttributeError, OSError):
        os.setsid()
    # Daemons may not have children, but policies may need some.
    current_process().daemon = False
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        load_plugins()
        session = Session(instance_of(name, arguments))
    except LemmaError as error:
        refusal = messages.Error(kind="request", message=str(error))
        pipe.send_bytes(messages.encode(refusal))
        return
    if "torch" in sys.modules:
        # More threads would compete with the other workers for cores.
        sys.modules["torch"].set_num_threads(1)
    # Send the answer to a hello without a request: it signals readiness.
    hello = messages.encode(messages.Hello(protocol=messages.PROTOCOL))
    pipe.send_bytes(session.answer(hello))
    with suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            pipe.send_bytes(session.answer(pipe.recv_bytes()))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    with suppress(AttributeError, OSError):
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)
    os._exit(1)
