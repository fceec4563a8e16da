"""Servers and clients of other versions, or of somebody's own making."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import msgpack
import pytest
from faulty_policies import Scripted, asking, end, given, start
from websockets.exceptions import ConnectionClosed
from websockets.sync import server as raw

from lemma.serve import server, websocket
from lemma.serve.conversation import ProtocolMode
from lemma.serve.faults import (
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.messages import LARGEST_BYTES
from lemma.serve.server import PolicyServer
from lemma.serve.websocket import WebSocketChannel, connect, websocket_address

SOON_S = 10.0
PATIENT = ProtocolMode(60.0, 60.0, 10.0)


@contextmanager
def answering(*answers: Any) -> Iterator[str]:
    """Run a server of somebody's own that says the same to everybody.

    The client has to hang up in the end, whatever was answered.
    """
    left = threading.Event()

    def talk(connection: Any) -> None:
        for answer in answers:
            connection.recv()
            frame = answer if isinstance(answer, bytes | str) else msgpack.packb(answer)
            connection.send(frame)
        with pytest.raises(ConnectionClosed):
            connection.recv()
        left.set()

    with raw.serve(talk, "127.0.0.1", 0) as own:
        thread = threading.Thread(target=own.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{own.socket.getsockname()[1]}"
        assert left.wait(SOON_S)
    thread.join()


HELLO = {"type": "hello", "protocol": 2, "methods": ["act"], "policy": {}}


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        ({**HELLO, "protocol": 1}, "version 1"),
        ({"type": "good day"}, "good day"),
        ({"type": "hello"}, "protocol"),
        ({"type": "decisions", "decisions": []}, "not Welcome"),
        ("Good day!", "not text"),
        (b"\xc1", "not msgpack"),
        (
            b"\x83\xa4type\xa5hello\xa8protocol\x02\xa6policy"
            + b"\x81\xa1a" * 1_000_000,
            "bytes",
        ),
        ({"type": "error", "kind": "request", "message": "Go away."}, "Go away"),
        ({**HELLO, "methods": ["dance"]}, "none of act, plan, ground"),
        ({**HELLO, "methods": None}, "methods"),
    ],
)
def test_another_language_is_reported(hello: Any, words: str) -> None:
    with answering(hello) as url, pytest.raises(ProtocolError, match=words):
        connect(url, PATIENT)


@pytest.fixture
def served() -> Iterator[PolicyServer]:
    with PolicyServer(Scripted(), port=0) as server:
        yield server


def exchange(channel: WebSocketChannel, frame: Any) -> dict[str, Any]:
    channel.send(frame if isinstance(frame, bytes | str) else msgpack.packb(frame))  # type: ignore[arg-type]
    reply: dict[str, Any] = msgpack.unpackb(channel.receive(SOON_S))
    return reply


def test_a_client_of_another_version_is_told_so(served: PolicyServer) -> None:
    channel = WebSocketChannel(websocket_address(served.url))
    reply = exchange(channel, {"type": "hello", "protocol": 99})
    assert (reply["type"], reply["kind"]) == ("error", "request")
    assert "version 99" in reply["message"]
    channel.close()


@pytest.mark.parametrize(
    "frame",
    [
        "text",
        b"",
        b"\x91" * 1_000_000,
        {"type": "act", "inputs": {}, "views": 3},
        {"type": "plan", "inputs": [], "views": []},
        {
            "type": "act",
            "inputs": [{"instruction": "", "robots": [], "view": 7}],
            "views": [],
        },
    ],
    ids=lambda frame: repr(frame)[:24],
)
def test_hostile_frames_are_answered_and_do_no_harm(
    served: PolicyServer, frame: Any
) -> None:
    channel = WebSocketChannel(websocket_address(served.url))
    for _ in range(2):
        reply = exchange(channel, frame)
        assert (reply["type"], reply["kind"]) == ("error", "request")
    channel.close()
    with asking(served.url, PATIENT) as policy:
        assert policy.act([given()]) == Scripted().act([given()])


def test_a_frame_beyond_the_limit_ends_its_connection_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(server, "LARGEST_BYTES", 1_000_000)
    assert LARGEST_BYTES > 1_000_000
    with PolicyServer(Scripted(), port=0) as served:
        channel = WebSocketChannel(websocket_address(served.url))
        with pytest.raises(OSError, match="1009"):
            exchange(channel, b"\x00" * 2_000_000)
        channel.close()
        with asking(served.url, PATIENT) as policy:
            assert policy.act([given()]) == Scripted().act([given()])


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        ({"type": "subtasks", "subtasks": []}, "malformed"),
        ({"type": "decisions", "decisions": []}, "malformed"),
        ({"type": "error", "kind": "raised", "message": "Oh."}, "raised"),
        ({"type": "error", "kind": "request", "message": "Oh."}, None),
        (b"\x91" * 1_000_000, "malformed"),
        (b"\x82\xa4type\xa5error\xa1x" + b"\x91" * 1_000_000, None),
        ("text", None),
    ],
    ids=lambda value: repr(value)[:24],
)
def test_hostile_answers_are_typed_errors(answer: Any, kind: str | None) -> None:
    with answering(HELLO, answer) as url, asking(url, PATIENT) as policy:
        with pytest.raises((PolicyFailedError, ProtocolError)) as failed:
            policy.act([given()])
        assert getattr(failed.value, "kind", None) == kind


@pytest.mark.slow
def test_a_server_that_reads_nothing_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(websocket, "_SEND_S", 1)
    monkeypatch.setattr(websocket, "_CONNECT_S", 0.3)
    process, url = start("Scripted")
    try:
        with asking(url, ProtocolMode(60.0, patience_s=0.3)) as policy:
            assert len(policy.act([given()])) == 1
            process.send_signal(signal.SIGSTOP)
            # The buffers of the system are full long before all of this is sent.
            robots = tuple("r" * 1_000_000 for _ in range(50))
            with pytest.raises(PolicyUnreachableError, match="No answer from"):
                policy.act([replace(given(), robots=robots)])
    finally:
        end(process)
