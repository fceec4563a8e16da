"""Model servers of vla-eval: what is sent to them, and what their answers may be."""

import io
import time
from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np
import pytest
from faulty_policies import Scripted
from model_server import HELLO, array, model_server, pack, wait_for
from PIL import Image

from lemma.core.errors import InvalidConfigError
from lemma.policies.control.interfaces import is_model_server
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
from lemma.serve.vla_eval import Kind, Message, observation

SOON = ProtocolMode(5.0, patience_s=0.0, first_patience_s=0.0)
NAMES = ("robot_0.x", "robot_0.opening", "robot_1.x", "robot_1.opening")
TASK = {"name": "stack", "split": "test", "episode_idx": 3}
RIGHT = np.array([0.1, 0.2, 0.3, 0.4], np.float32)


def seen(number: int = 0) -> dict[str, Any]:
    image = np.full((4, 6, 3), number, np.uint8)
    state = np.arange(3) + number
    return observation({"robot_0": image, "overview": image + 1}, "stack it", state)


def one_answer(predict: Any, mode: ProtocolMode = SOON) -> Any:
    with model_server(predict) as url:
        server = ModelServer(url, mode)
        episode = server.begin(TASK, NAMES)
        [found] = server.act([episode], [seen()])
        server.close()
    return found


def test_an_episode_is_told_and_observed_as_its_servers_expect() -> None:
    log: list[dict[str, Any]] = []
    with model_server(lambda seen, step: {"actions": RIGHT + step}, log=log) as url:
        server = ModelServer(url, SOON)
        assert server.about["model_server"] == "Stub"
        episode = server.begin(TASK, NAMES)
        for step in range(2):
            [action] = server.act([episode], [seen(step)])
            np.testing.assert_array_equal(action, (RIGHT + step).astype(np.float64))
        episode.end({"success": True})
        again = server.begin({**TASK, "episode_idx": 4}, NAMES)
        again.end({"success": False})
        wait_for(log, "episode_end", 2)
        server.close()
    kinds = [message["type"] for message in log]
    between = ["episode_start", "observation", "observation", "episode_end"]
    # One connection, so one hello.
    assert kinds == ["hello", *between, "episode_start", "episode_end"]
    assert log[0]["payload"]["protocol_version"] == 1
    assert log[1]["payload"] == {"task": TASK}
    given = log[3]["payload"]
    assert set(given) == {"images", "task_description", "states"}
    assert given["task_description"] == "stack it"
    assert given["states"].dtype == np.float32
    np.testing.assert_array_equal(given["states"], [1, 2, 3])
    np.testing.assert_array_equal(given["images"]["overview"], np.full((4, 6, 3), 2))
    assert given["images"]["robot_0"].dtype == np.uint8
    assert log[4]["payload"] == {"success": True}
    numbers = [message["seq"] for message in log[1:]]
    assert len(set(numbers)) == len(numbers)


def test_episodes_have_connections_of_their_own_and_fail_alone() -> None:
    started: list[int] = []

    def predict(seen: Mapping[str, Any], step: int) -> Any:
        if seen["states"][0] == 7:
            raise ValueError("no seven")
        return {"actions": np.full(4, float(seen["states"][0]) + 0.1 * step)}

    with model_server(
        predict, on_start=lambda p: started.append(p["task"]["episode_idx"])
    ) as url:
        server = ModelServer(url, SOON)
        episodes = [
            server.begin({**TASK, "episode_idx": index}, NAMES) for index in (5, 6, 7)
        ]
        server.act(episodes[:1], [seen(5)])
        found = server.act(episodes, [seen(5), seen(6), seen(7)])
        assert [round(float(one[0]), 1) for one in found[:2]] == [5.1, 6.0]  # type: ignore[index]
        assert isinstance(found[2], PolicyFailedError)
        assert found[2].kind is FaultKind.RAISED
        assert "no seven" in str(found[2])
        server.close()
    assert sorted(started) == [5, 6, 7]


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
    assert found.shape == (4,)
    assert found.dtype == np.float64


def test_a_server_that_hangs_is_hung_up_on_and_may_play_the_next_episode() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        if seen["states"][0] == 1:
            time.sleep(0.6)
        return {"actions": RIGHT}

    with model_server(predict) as url:
        server = ModelServer(url, ProtocolMode(0.2, 0.0, 0.0))
        episode = server.begin(TASK, NAMES)
        [found] = server.act([episode], [seen(1)])
        assert isinstance(found, PolicyFailedError)
        assert found.kind is FaultKind.TIMEOUT
        assert "within 0.2 s" in str(found)
        server.mode = SOON
        [found] = server.act([server.begin(TASK, NAMES)], [seen(0)])
        assert isinstance(found, np.ndarray)
        server.close()


def test_an_episode_that_cannot_begin_is_told_with_its_first_action() -> None:
    def on_start(payload: Mapping[str, Any]) -> None:
        raise KeyError("no such task")

    with model_server(lambda seen, step: {"actions": RIGHT}, on_start=on_start) as url:
        server = ModelServer(url, SOON)
        episode = server.begin(TASK, NAMES)
        for words in ("episode_start_failed", "hung up"):
            [found] = server.act([episode], [seen()])
            assert isinstance(found, PolicyFailedError)
            assert words in str(found)
        server.close()


def test_late_answers_are_not_taken_for_others() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        stray = pack("action", {"actions": RIGHT + 9}, 999)
        return stray if step == 0 else {"actions": RIGHT}

    with model_server(predict) as url:
        server = ModelServer(url, ProtocolMode(0.2, 0.0, 0.0))
        [found] = server.act([server.begin(TASK, NAMES)], [seen()])
        assert isinstance(found, PolicyFailedError)
        assert found.kind is FaultKind.TIMEOUT
        server.close()


def test_a_server_that_is_gone_ends_the_run() -> None:
    with model_server(lambda seen, step: {"actions": RIGHT}) as url:
        server = ModelServer(url, SOON)
        episode = server.begin(TASK, NAMES)
    with pytest.raises(PolicyUnreachableError, match="Nobody answers"):
        server.act([episode], [seen()])
    with pytest.raises(PolicyUnreachableError, match="its model server"):
        server.begin(TASK, NAMES)
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
    with model_server(lambda seen, step: None, hello=hello) as url:
        server = ModelServer(url, SOON)
        if fits:
            server.check_actions("ee_pose", NAMES)
        else:
            with pytest.raises(InvalidConfigError, match="Choose the control mode"):
                server.check_actions("ee_pose", NAMES)
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
