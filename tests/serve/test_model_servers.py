"""Model servers of vla-eval: what is sent to them, and what their answers may be."""

import io
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from typing import Any

import msgpack
import numpy as np
import pytest
from faulty_policies import Scripted
from model_server import HELLO, array, model_server, pack, wait_for
from PIL import Image

from lemma.core.errors import InvalidConfigError
from lemma.policies.control.interfaces import Actions, ControlInput, is_model_server
from lemma.serve import vla_eval as protocol
from lemma.serve.conversation import ProtocolMode
from lemma.serve.faults import (
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
    ProtocolError,
)
from lemma.serve.model_server import ModelServer
from lemma.serve.server import PolicyServer
from lemma.serve.vla_eval import Kind, Message

SOON = ProtocolMode(5.0, patience_s=0.0, first_patience_s=0.0)
OPTIONS, COLUMNS = {"control": "ee_pose"}, ("x", "opening")
RIGHT = np.array([0.1, 0.2, 0.3, 0.4], np.float32)


def seen(number: int = 0, memory: Any = None) -> ControlInput:
    image = np.full((4, 6, 3), number, np.uint8)
    pixels = {"robot_0": image, "overview": image + 1}
    return ControlInput(
        instruction="stack it",
        robots=("red robot", "blue robot"),
        observation={"agent_pos": np.arange(3) + number, "pixels": pixels},
        memory=memory,
    )


@contextmanager
def asked(url: str, mode: ProtocolMode = SOON) -> Iterator[ModelServer]:
    server = ModelServer(url, mode)
    server.use(OPTIONS, COLUMNS)
    yield server
    server.close()


def one_answer(predict: Any, mode: ProtocolMode = SOON) -> Any:
    with model_server(predict) as url, asked(url, mode) as server:
        return server.act([seen()])[0]


def test_an_episode_is_told_and_observed_as_its_servers_expect() -> None:
    log: list[dict[str, Any]] = []
    with (
        model_server(lambda seen, step: {"actions": RIGHT + step}, log=log) as url,
        asked(url) as server,
    ):
        assert server.about["model_server"] == "Stub"
        memory: Any = None
        for step in range(2):
            [action] = server.act([seen(step, memory)])
            assert isinstance(action, Actions)
            memory = action.memory
            wanted = (RIGHT + step).astype(np.float64).reshape(2, 2)
            np.testing.assert_array_equal(action.rows, wanted)
        # An episode ends when nobody remembers it.
        del memory, action
        [action] = server.act([seen()])
        del action
        wait_for(log, "episode_end", 2)
    kinds = [message["type"] for message in log]
    start, end = ["episode_start", "observation"], ["episode_end"]
    # One connection, so one hello.
    assert kinds == ["hello", *start, "observation", *end, *start, *end]
    assert log[0]["payload"]["protocol_version"] == 1
    assert log[1]["payload"] == {"task": {"name": "lemma", "suite": "lemma"}}
    given = log[3]["payload"]
    assert set(given) == {"images", "task_description", "states", "robots"}
    assert given["task_description"] == "stack it"
    assert given["robots"] == ["red robot", "blue robot"]
    assert given["states"].dtype == np.float32
    np.testing.assert_array_equal(given["states"], [1, 2, 3])
    np.testing.assert_array_equal(given["images"]["overview"], np.full((4, 6, 3), 2))
    assert given["images"]["robot_0"].dtype == np.uint8
    assert log[4]["payload"] == {}
    numbers = [message["seq"] for message in log[1:]]
    assert len(set(numbers)) == len(numbers)


def test_episodes_have_connections_of_their_own_and_fail_alone() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        if seen["states"][0] == 7:
            raise ValueError("no seven")
        return {"actions": np.full(4, float(seen["states"][0]) + 0.1 * step)}

    log: list[dict[str, Any]] = []
    with model_server(predict, log=log) as url, asked(url) as server:
        [first] = server.act([seen(5)])
        assert isinstance(first, Actions)
        found: list[Any] = server.act([seen(5, first.memory), seen(6), seen(7)])
        assert [round(float(one.rows[0][0]), 1) for one in found[:2]] == [5.1, 6.0]
        assert isinstance(found[2], PolicyFailedError)
        assert found[2].kind is FaultKind.RAISED
        assert "no seven" in str(found[2])
        assert sum(message["type"] == "episode_start" for message in log) == 3


@pytest.mark.parametrize(
    ("payload", "kind", "words"),
    [
        ({}, FaultKind.MALFORMED, "holds nothing, and no 'actions'"),
        ({"act": RIGHT}, FaultKind.MALFORMED, "'act'"),
        ({"actions": RIGHT[:3]}, FaultKind.MALFORMED, r"shape \(3,\).*\(4,\)"),
        ({"actions": np.tile(RIGHT, (5, 1))}, FaultKind.MALFORMED, "chunk_size=5"),
        ({"actions": "left"}, FaultKind.MALFORMED, "no numbers"),
        ({"actions": [[1, 2], [3]]}, FaultKind.MALFORMED, "no array"),
        ({"actions": None}, FaultKind.MALFORMED, "no numbers"),
        (
            {"actions": RIGHT * [1, np.nan, 1, 1]},
            FaultKind.NOT_FINITE,
            "robot_0.opening is nan",
        ),
        ({"action": [0, 0, np.inf, 0]}, FaultKind.NOT_FINITE, "robot_1.x is inf"),
        (b"nonsense", FaultKind.MALFORMED, "does not fit"),
        (
            {"actions": {**array(RIGHT), "shape": [5]}},
            FaultKind.MALFORMED,
            "16 bytes instead of 20",
        ),
        (
            {"actions": {**array(RIGHT), "dtype": "|O"}},
            FaultKind.MALFORMED,
            "cannot be read",
        ),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_bad_answers_say_what_is_wrong_and_what_is_valid(
    payload: Any, kind: FaultKind, words: str
) -> None:
    found = one_answer(lambda seen, step: payload)
    assert isinstance(found, PolicyFailedError)
    assert found.kind is kind
    with pytest.raises(PolicyFailedError, match=words):
        raise found


@pytest.mark.parametrize(
    "payload", [{"actions": RIGHT[None]}, {"action": [0, 1, 2, 3]}]
)
def test_good_answers_are_one_row(payload: dict[str, Any]) -> None:
    found = one_answer(lambda seen, step: payload)
    assert found.rows.shape == (2, 2)
    assert found.rows.dtype == np.float64


def test_a_server_that_hangs_is_hung_up_on_and_may_play_the_next_episode() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        if seen["states"][0] == 1:
            time.sleep(0.6)
        return {"actions": RIGHT}

    with (
        model_server(predict) as url,
        asked(url, ProtocolMode(0.2, 0.0, 0.0)) as server,
    ):
        [found] = server.act([seen(1)])
        assert isinstance(found, PolicyFailedError)
        assert found.kind is FaultKind.TIMEOUT
        assert "within 0.2 s" in str(found)
        server.mode = SOON
        assert isinstance(server.act([seen(0)])[0], Actions)


def test_an_episode_that_cannot_begin_is_told_with_its_first_action() -> None:
    started: list[int] = []

    def on_start(payload: Mapping[str, Any]) -> None:
        started.append(1)
        if len(started) == 2:
            raise KeyError("no such task")

    with (
        model_server(lambda seen, step: {"actions": RIGHT}, on_start=on_start) as url,
        asked(url) as server,
    ):
        first, found = server.act([seen(), seen()])
        assert isinstance(first, Actions)
        assert isinstance(found, PolicyFailedError)
        assert "episode_start_failed" in str(found)


def test_late_answers_are_not_taken_for_others() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        stray = pack("action", {"actions": RIGHT + 9}, 999)
        return stray if step == 0 else {"actions": RIGHT}

    found = one_answer(predict, ProtocolMode(0.2, 0.0, 0.0))
    assert isinstance(found, PolicyFailedError)
    assert found.kind is FaultKind.TIMEOUT


def test_a_server_that_is_gone_ends_the_run() -> None:
    with model_server(lambda seen, step: {"actions": RIGHT}) as url:
        server = ModelServer(url, SOON)
        server.use(OPTIONS, COLUMNS)
        [found] = server.act([seen()])
        assert isinstance(found, Actions)
    for memory in (found.memory, None):
        with pytest.raises(PolicyUnreachableError, match="its model server"):
            server.act([seen(0, memory)])
    with pytest.raises(PolicyUnreachableError):
        ModelServer(url, SOON)


def test_another_version_or_language_is_reported() -> None:
    old = {**HELLO, "protocol_version": 2}
    with (
        model_server(lambda seen, step: None, hello=old) as url,
        pytest.raises(ProtocolError, match=r"version 2.*Install vla-eval 0\.8"),
    ):
        ModelServer(url, SOON)
    with (
        PolicyServer(Scripted(), port=0) as ours,
        pytest.raises(ProtocolError, match="begins with http://"),
    ):
        ModelServer(ours.url.replace("http", "vla-eval"), SOON)


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "vla-eval://", "vla-eval://a:b"])
def test_an_address_names_a_host(url: str) -> None:
    with pytest.raises(InvalidConfigError, match="as in vla-eval://"):
        ModelServer(url, SOON)


def part(form: str, dims: int) -> dict[str, Any]:
    return {"name": "part", "format": form, "dims": dims}


@pytest.mark.parametrize(
    ("spec", "fits"),
    [
        ({}, True),
        ({"actions": part("raw", 0)}, True),
        ({"actions": part("lemma_ee_pose", 4)}, True),
        ({"actions": part("raw", 7)}, False),
        ({"actions": part("lemma_delta_ee_pose", 4)}, False),
        ({"position": part("delta_xyz", 3), "gripper": part("raw", 1)}, False),
    ],
)
def test_declared_actions_are_compared(spec: dict[str, Any], fits: bool) -> None:
    hello = {**HELLO, "action_spec": spec}
    expected: Any = nullcontext()
    if not fits:
        expected = pytest.raises(InvalidConfigError, match="Choose the control mode")
    with model_server(lambda seen, step: None, hello=hello) as url:
        server = ModelServer(url, SOON)
        with expected:
            server.use(OPTIONS, COLUMNS)
        server.close()


def test_compressed_images_are_read() -> None:
    image = np.random.default_rng(0).integers(0, 255, (8, 6, 3), dtype=np.uint8)
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG")
    sent = {"__image__": True, "format": "png", "data": stream.getvalue()}
    frame = pack("observation", {"images": {"a": sent}}, 3)
    found = protocol.unpack(frame).payload["images"]["a"]
    np.testing.assert_array_equal(found, image)
    for damaged in ({**sent, "data": b"no"}, {**sent, "format": "gif"}):
        with pytest.raises(ProtocolError, match="An image"):
            protocol.unpack(pack("observation", {"image": damaged}, 3))


@pytest.mark.parametrize(
    "frame",
    [
        "text",
        b"\xc1",
        b"\x91" * 100_000,
        msgpack.packb([1]),
        msgpack.packb({"type": "action"}),
        pack("dance", {}, 1),
        pack("action", [], 1),
        pack("action", {}, "one"),  # type: ignore[arg-type]
        msgpack.packb(
            {"type": "action", "payload": {"a": 1}, "seq": 1, "timestamp": None}
        ),
    ],
    # Not of their bytes, which say the time: workers must name tests alike.
    ids=(
        *("text", "reserved", "deep", "a list", "no payload", "unknown type"),
        *("a list as payload", "a word as number", "no time"),
    ),
)
def test_hostile_frames_are_typed_errors(frame: Any) -> None:
    with pytest.raises(ProtocolError):
        protocol.unpack(frame)


def test_what_cannot_be_sent_is_an_error() -> None:
    with pytest.raises(ProtocolError, match="cannot be sent"):
        protocol.pack(Message.of(Kind.ACTION, {"a": object()}))
    with pytest.raises(ProtocolError, match="cannot be sent"):
        protocol.pack(Message.of(Kind.ACTION, {"a": np.array(["text"])}))


def test_names_of_servers_are_told_from_others() -> None:
    assert is_model_server("vla-eval://127.0.0.1:8001")
    assert not is_model_server("http://127.0.0.1:8001")
