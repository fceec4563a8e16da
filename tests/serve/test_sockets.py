"""Policies behind real sockets, which die, hang, forget, and come back."""

import gc
import socket
import subprocess
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_policies import (
    BAD,
    MOVE,
    Hangs,
    Scripted,
    asking,
    end,
    given,
    moved,
    start,
    view,
)
from interpreter import told_without

from lemma.core.errors import InvalidConfigError
from lemma.env.view import View
from lemma.evaluation.run.fault_isolation import Fault, IsolatedPolicy
from lemma.policies.interfaces import Decision, OracleInput, PastStep, PolicyInput
from lemma.serve.conversation import Conversation, ProtocolMode, remote
from lemma.serve.faults import (
    FaultKind,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.messages import Act, Hello, decode_request
from lemma.serve.model_server import ModelServer
from lemma.serve.server import PolicyServer
from lemma.serve.websocket import WebSocketChannel, connect, websocket_address

PATIENT = ProtocolMode(60.0, 60.0, 10.0)
HERE = Path(__file__).parent


class Listening:
    """A channel that keeps what it sends."""

    def __init__(self, address: str, log: list[Any]) -> None:
        self._channel, self._log = WebSocketChannel(address), log

    def send(self, message: bytes) -> None:
        self._log.append(decode_request(message))
        self._channel.send(message)

    def receive(self, timeout_s: float) -> bytes | str:
        return self._channel.receive(timeout_s)

    def close(self) -> None:
        self._channel.close()


def listen(url: str, log: list[Any]) -> Any:
    address = websocket_address(url)
    return remote(Conversation(url, lambda: Listening(address, log), PATIENT))


@pytest.fixture
def served() -> Iterator[PolicyServer]:
    with PolicyServer(Scripted(), port=0, about={"weights": "none"}) as server:
        yield server


def histories(count: int, steps: int) -> list[PolicyInput]:
    """Return episodes that differ, with their past."""
    found = []
    for number in range(count):
        past = tuple(
            PastStep(view(10 * number + k, 20, 30), MOVE, "dropped")
            for k in range(steps)
        )
        now = view(10 * number + steps, 20, 30)
        found.append(given(f"episode {number}", *past, now=now))
    return found


def went_on(inputs: Sequence[PolicyInput]) -> list[PolicyInput]:
    """Return the same episodes one step later."""
    return [
        replace(
            one,
            past=(*one.past, PastStep(one.view, MOVE)),
            view=view(len(one.past) + 100, 20, 30),
        )
        for one in inputs
    ]


def views_sent(log: list[Any]) -> list[int]:
    return [len(message.views) for message in log if isinstance(message, Act)]


def test_a_socket_decides_as_its_policy_does(served: PolicyServer) -> None:
    policy: Any = connect(served.url, PATIENT)
    assert policy.about == {"name": "Scripted", "weights": "none"}
    inputs = [*histories(3, 0), *histories(2, 1), *histories(1, 2)]
    assert policy.act(inputs) == Scripted().act(inputs)
    policy.close()
    # Hanging up is no farewell.
    assert policy.act(inputs) == Scripted().act(inputs)
    policy.close()


def test_views_of_the_last_request_are_not_sent_again(served: PolicyServer) -> None:
    log: list[Any] = []
    policy = listen(served.url, log)
    inputs = histories(3, 0)
    for _ in range(4):
        assert policy.act(inputs) == Scripted().act(inputs)
        inputs = went_on(inputs)
    assert views_sent(log) == [3, 3, 3, 3]
    # One episode ends; the others go on.
    assert policy.act(inputs[1:]) == Scripted().act(inputs[1:])
    # Views that were left out of a request are told anew.
    assert policy.act(inputs) == Scripted().act(inputs)
    assert views_sent(log)[4:] == [2, 5]
    policy.close()
    assert policy.act(inputs) == Scripted().act(inputs)
    assert views_sent(log)[6:] == [15]
    policy.close()


def test_neither_side_keeps_more_views_than_the_last_request_has() -> None:
    kept: list[weakref.ref[View]] = []

    class Notes(Scripted):
        def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
            kept.append(weakref.ref(inputs[0].view))
            return super().act(inputs)

    with asking(Notes(), PATIENT) as policy:
        for number in range(3):
            inputs = histories(1, number)
            kept.append(weakref.ref(inputs[0].view))
            policy.act(inputs)
        del inputs
        gc.collect()
        # Those of the client and those of the server, of the last request alone.
        assert [one() is not None for one in kept] == [False] * 4 + [True] * 2


def test_the_truth_never_travels(served: PolicyServer) -> None:
    log: list[Any] = []
    policy = listen(served.url, log)
    truth: Any = object()
    plain = given()
    policy.act(
        [OracleInput(plain.instruction, plain.robots, plain.view, episode=truth)]
    )
    greeting, asked = log
    assert isinstance(greeting, Hello)
    assert asked.__struct_fields__ == ("inputs", "views")
    assert asked.inputs[0].__struct_fields__ == (
        *("instruction", "robots", "view", "past", "hands"),
    )
    policy.close()


def test_explanations_of_the_past_arrive() -> None:
    heard: list[str] = []

    class Listens(Scripted):
        def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
            heard.extend(step.explanation for step in inputs[0].past)
            return super().act(inputs)

    failed = PastStep(view(1, 20, 30), MOVE, "unreachable", "It is too far.")
    with asking(Listens(), PATIENT) as policy:
        policy.act([given("go", failed, now=view(2, 20, 30))])
    assert heard == ["It is too far."]


def test_a_server_killed_and_started_again_changes_nothing() -> None:
    process, url = start("Scripted")
    policy: Any = connect(url, PATIENT)
    port = int(url.rpartition(":")[2])
    again: list[subprocess.Popen[str]] = []

    def come_back() -> None:
        time.sleep(0.5)
        again.append(start("Scripted", port)[0])

    inputs = histories(4, 0)
    assert policy.act(inputs) == Scripted().act(inputs)
    end(process)
    thread = threading.Thread(target=come_back)
    thread.start()
    # The whole past is told again, to a server that knows nothing.
    inputs = went_on(went_on(inputs))
    assert policy.act(inputs) == Scripted().act(inputs)
    thread.join()
    policy.close()
    end(again[0])


@contextmanager
def supervised(name: str) -> Iterator[str]:
    """Start a server again whenever it dies, as a container would."""
    process, url = start(name)
    running, stopped = [process], threading.Event()

    def watch() -> None:
        while not stopped.is_set():
            if running[0].poll() is not None:
                end(running[0])
                running[0] = start(name, int(url.rpartition(":")[2]))[0]
            time.sleep(0.05)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield url
    finally:
        stopped.set()
        thread.join()
        end(running[0])


@pytest.mark.slow
def test_a_request_that_kills_the_server_costs_its_episode_alone() -> None:
    with (
        supervised("Crashes") as url,
        asking(url, ProtocolMode(60.0, deaths=2)) as policy,
    ):
        good, bad, other = IsolatedPolicy(policy).decide(
            [given("a"), given(BAD), given("b")]
        )
        assert good == other == moved()
        assert isinstance(bad, Fault)
        assert bad.kind is FaultKind.DIED


def test_a_server_that_hangs_costs_its_episode_alone() -> None:
    with asking(Hangs(), ProtocolMode(0.3)) as policy:
        answers = IsolatedPolicy(policy).decide([given("a"), given(BAD), given("b")])
        assert [isinstance(a, Decision) for a in answers] == [True, False, True]
        assert isinstance(answers[1], Fault)
        assert answers[1].kind is FaultKind.TIMEOUT
        # Other clients of the same server are answered.
        with asking(policy.conversation.where, PATIENT) as other:
            assert other.act([given()]) == [moved()]


def test_a_slow_policy_is_waited_for() -> None:
    class Slow(Scripted):
        def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
            time.sleep(0.7)
            return super().act(inputs)

    # Three decisions may take three times as long as one.
    with asking(Slow(), ProtocolMode(0.5)) as policy:
        assert len(policy.act([given("a"), given("b"), given("c")])) == 3


def test_a_big_batch_arrives(served: PolicyServer) -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (288, 416, 3), np.uint8)
    inputs = []
    for number in range(24):
        seen = replace(view(number, 288, 416), rgb=noise)
        inputs.append(given(f"{number}", now=seen))
    with asking(served.url, PATIENT) as policy:
        assert policy.act(inputs) == Scripted().act(inputs)


def test_many_clients_are_answered_one_after_another(served: PolicyServer) -> None:
    results: dict[int, list[Decision]] = {}

    def ask(number: int) -> None:
        with asking(served.url, PATIENT) as policy:
            for _ in range(5):
                results[number] = policy.act(histories(number + 1, 1))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number in range(4):
        assert results[number] == Scripted().act(histories(number + 1, 1))


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def test_nobody_there_is_reported() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with pytest.raises(PolicyUnreachableError, match=url):
        connect(url, ProtocolMode(1.0, 0.3, 0.3))


def test_a_server_gone_for_good_is_no_fault_of_the_policy() -> None:
    with PolicyServer(Scripted(), port=0) as server:
        policy: Any = connect(server.url, ProtocolMode(1.0, 0.3, 0.3))
        assert len(policy.act([given()])) == 1
    with pytest.raises(PolicyUnreachableError, match="finished episodes are kept"):
        IsolatedPolicy(policy).decide([given(), given()])


@pytest.mark.parametrize(
    "url", ["http://", "127.0.0.1:8000", "http://host:port", "ftp://host:1", "ws://h:0"]
)
def test_addresses_are_checked(url: str) -> None:
    with pytest.raises(InvalidConfigError, match=r"http://127\.0\.0\.1:8000"):
        websocket_address(url)


def test_addresses_may_be_written_in_four_ways() -> None:
    assert websocket_address("http://a:1/x") == "ws://a:1/x"
    assert websocket_address("https://a") == "wss://a"
    assert websocket_address("ws://[::1]:8000") == "ws://[::1]:8000"


def test_an_address_with_a_password_is_refused_without_telling_it() -> None:
    secret = ("http://me:word@h:1", "http://me:word@h:x", "ws://h/?key=word")
    for url in (*secret, "ws://h/#xyz", "ws://h/a;key=xyz"):
        with pytest.raises(InvalidConfigError, match="LEMMA_SERVER_AUTH") as caught:
            websocket_address(url)
        assert "word@" not in str(caught.value)
        assert "xyz" not in str(caught.value)
    with pytest.raises(InvalidConfigError, match="LEMMA_SERVER_AUTH"):
        ModelServer("vla-eval://me:word@h:1", PATIENT)


@pytest.mark.parametrize(
    ("request_line", "status"),
    [
        (b"GET / HTTP/1.1", 200),
        (b"GET / HTTP/1.0", 200),
        (b"HEAD /health HTTP/1.1", 200),
        (b"POST / HTTP/1.1", 405),
        (b"\x16\x03\x01 \xff", 400),
        (b"", 0),
    ],
)
def test_probes_get_a_proper_answer_and_leave_no_traceback(
    served: PolicyServer,
    request_line: bytes,
    status: int,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    with socket.create_connection((served.host, served.port), 10.0) as probe:
        if not request_line:
            probe.shutdown(socket.SHUT_WR)
        else:
            probe.sendall(request_line + b"\r\nHost: h\r\n\r\n")
        answer = b"".join(iter(lambda: probe.recv(4096), b""))
    assert answer.startswith(f"HTTP/1.1 {status} ".encode() if status else b"")
    assert (b"policy server" in answer) == (status > 0 and b"HEAD" not in request_line)
    assert (capsys.readouterr().err, caplog.text) == ("", "")


def test_a_taken_port_is_explained(served: PolicyServer) -> None:
    with pytest.raises(InvalidConfigError, match="another port"):
        PolicyServer(Scripted(), port=served.port)
    with pytest.raises(ProtocolError, match="not a policy"):
        PolicyServer(object(), port=0)


def test_serving_needs_neither_simulator_nor_torch() -> None:
    code = """
from faulty_policies import Scripted
from lemma.serve import PolicyServer
with PolicyServer(Scripted(), port=0) as server:
    print(server.url)
"""
    absent = ("mujoco", "torch", "numba", "scipy", "pyarrow")
    assert told_without(absent, code).startswith("http://127.0.0.1:")
