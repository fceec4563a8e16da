"""Servers and clients of other versions, or of somebody's own making."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from faulty_policies import Scripted, given
from serving_processes import end, start
from websockets.sync import server as raw

from lemma.serve.client import websocket
from lemma.serve.client.conversation import ProtocolMode
from lemma.serve.client.websocket import WebSocketChannel, connect, websocket_address
from lemma.serve.protocol.faults import PolicyUnreachableError, ProtocolError
from lemma.serve.protocol.messages import Message
from lemma.serve.protocol.packing import pack, unpack
from lemma.serve.server.server import PolicyServer

PATIENT = ProtocolMode(60.0, 60.0, 10.0)


@contextmanager
def answering(*answers: Message) -> Iterator[str]:
    """Run a server of somebody's own that says the same to everybody."""

    def talk(connection: Any) -> None:
        for answer in answers:
            asked = unpack(connection.recv())
            connection.send(pack({"id": asked["id"], **answer}))
        connection.recv()

    with raw.serve(talk, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
    thread.join()


HELLO = {"type": "hello", "protocol": 1, "methods": ["act"], "policy": {}}


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        ({**HELLO, "protocol": 2}, "version 2"),
        ({"type": "good day"}, "version None"),
        ({"type": "error", "kind": "request", "message": "Go away."}, "Go away"),
        ({**HELLO, "methods": ["dance"]}, "none of act, plan, ground"),
        ({**HELLO, "methods": None}, "lacks 'methods'"),
    ],
)
def test_another_language_is_reported(hello: Message, words: str) -> None:
    with answering(hello) as url, pytest.raises(ProtocolError, match=words):
        connect(url, PATIENT)


@pytest.fixture
def served() -> Iterator[PolicyServer]:
    with PolicyServer(Scripted(), port=0) as server:
        yield server


def test_a_client_of_another_version_is_told_so(served: PolicyServer) -> None:
    channel = WebSocketChannel(websocket_address(served.url))
    channel.send({"type": "hello", "protocol": 99, "id": 1})
    reply = channel.receive(60.0)
    assert (reply["type"], reply["kind"]) == ("error", "request")
    assert "version 99" in reply["message"]
    for nonsense in ({"type": "dance"}, {"type": "act"}, {"type": "reset"}):
        channel.send({**nonsense, "id": 2})
        assert channel.receive(60.0)["type"] == "error"
    channel.close()


def test_a_server_that_always_misses_views_is_given_up() -> None:
    missing: Message = {"type": "missing", "episodes": [0], "views": []}
    ready: Message = {"type": "ready"}
    with answering(HELLO, *([ready, missing] * 4)) as url:
        policy: Any = connect(url, PATIENT)
        with pytest.raises(ProtocolError, match="again and again"):
            policy.act([given()])
        policy.close()


@pytest.mark.slow
def test_a_server_that_reads_nothing_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(websocket, "_SEND_S", 1)
    monkeypatch.setattr(websocket, "_CONNECT_S", 0.3)
    process, url = start("Scripted")
    try:
        policy: Any = connect(url, ProtocolMode(60.0, patience_s=0.3))
        assert len(policy.act([given()])) == 1
        process.send_signal(signal.SIGSTOP)
        # The buffers of the system are full long before all of this is sent.
        robots = tuple("r" * 1_000_000 for _ in range(50))
        with pytest.raises(PolicyUnreachableError, match="Nobody answers"):
            policy.act([replace(given(), robots=robots)])
        policy.close()
    finally:
        end(process)
