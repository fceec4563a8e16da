"""Messages arrive as they were sent, to the bit; other bytes are refused."""

import math
import time
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from faulty_policies import MOVE, moved, view
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lemma.core.poses import Pose2
from lemma.policies.interfaces import Decision
from lemma.serve.arrays import VIEW_ARRAYS, Array, ViewMessage
from lemma.serve.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.messages import (
    Act,
    Decisions,
    Poses,
    decode_reply,
    decode_request,
    encode,
)
from lemma.tasks.subtask import STOP, GroundedSubTask

SOON_S = 5.0
arrays_of: Any = arrays.arrays
"""Of any type: mypy takes three seconds to choose between its overloads."""


def plain(message: Any) -> dict[str, Any]:
    """Return what anybody's msgpack makes of a message."""
    found: dict[str, Any] = msgpack.unpackb(encode(message))
    return found


def asked(**changes: Any) -> dict[str, Any]:
    """Return a request as others may write it."""
    one = plain(Act(inputs=[], views=[ViewMessage.of(0, view())]))
    [seen] = one["views"]
    past = [{"view": 0, "subtask": MOVE.to_dict(), "outcome": "dropped"}]
    told = {"instruction": "go", "robots": ["a", "b"], "view": 0, "past": past}
    return {"type": "act", "inputs": [told], "views": [seen], **changes}


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(VIEW_ARRAYS)).flatmap(
        lambda name: st.tuples(
            st.just(name),
            arrays_of(
                np.dtype(VIEW_ARRAYS[name][0]),
                arrays.array_shapes(
                    min_dims=VIEW_ARRAYS[name][1],
                    max_dims=VIEW_ARRAYS[name][1],
                    min_side=0,
                ),
            ),
        )
    )
)
def test_arrays_keep_type_shape_and_bits(case: tuple[str, np.ndarray]) -> None:
    name, array = case
    found = Array.of(array, str(array.dtype)).read(name)
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.tobytes() == array.tobytes()


def test_arrays_of_other_layouts_arrive_in_order() -> None:
    array = np.arange(12.0).reshape(3, 4).T
    for one in (array, array.astype(">f8"), array.astype(np.float32)):
        assert np.array_equal(Array.of(one, "float64").read("joints"), array)


def test_views_and_decisions_arrive() -> None:
    sent = view(7)
    request = decode_request(encode(Act(inputs=[], views=[ViewMessage.of(3, sent)])))
    assert isinstance(request, Act)
    [message] = request.views
    assert message.number == 3
    found = message.read()
    for name in VIEW_ARRAYS:
        assert np.array_equal(getattr(found, name), getattr(sent, name))
        assert getattr(found, name).dtype == getattr(sent, name).dtype
        assert not getattr(found, name).flags.writeable
    decisions = [moved(), Decision(STOP, None), Decision(MOVE, None, "lost")]
    assert decode_reply(encode(Decisions(decisions=decisions))) == Decisions(
        decisions=decisions
    )


def test_numbers_of_numpy_are_numbers() -> None:
    pose = Pose2(np.float32(0.5), np.float64(0.25), np.int64(1))  # type: ignore[arg-type]
    grounded = GroundedSubTask("robot_0", MOVE.primitive, pose, pose)
    reply = decode_reply(encode(Poses(poses=[grounded, None])))
    assert isinstance(reply, Poses)
    assert reply.poses[0] is not None
    assert reply.poses[0].pick == Pose2(0.5, 0.25, 1.0)


def test_numbers_that_are_none_pass_to_whoever_judges_them() -> None:
    reply = decode_reply(encode(Decisions(decisions=[moved(math.nan, math.inf)])))
    assert isinstance(reply, Decisions)
    assert reply.decisions[0].grounded is not None
    assert math.isnan(reply.decisions[0].grounded.pick.x)


# Prefixes of a request, after which anything may come.
_INPUTS = b"\x82\xa4type\xa3act\xa6inputs"
_OTHER = b"\x82\xa4type\xa3act\xa5other"


@pytest.mark.parametrize(
    "data",
    [
        "text",
        b"",
        b"\xc1",
        b"\x93\x01\x02\x03",
        encode(Act(inputs=[], views=[]))[:-1],
        b"\x81\xa4type\x05",
        b"\x81\xa4type\xa4swim",
        b"\x81\xa4type\xa5\xff\xff\xff\xff\xff",
        # Sizes of four billion, with nothing behind them.
        _INPUTS + b"\xdd\xff\xff\xff\xff",
        _INPUTS + b"\xdf\xff\xff\xff\xff",
        _INPUTS + b"\xc6\xff\xff\xff\xff",
        _OTHER + b"\xdd\xff\xff\xff\xff",
        # Ten million lists in one another.
        _INPUTS + b"\x91" * 10_000_000,
        _OTHER + b"\x91" * 10_000_000 + b"\xc0",
    ],
    ids=lambda data: repr(data[:24]),
)
@pytest.mark.parametrize("decode", [decode_request, decode_reply])
def test_what_is_no_message_is_refused_at_once(
    decode: Callable[[bytes | str], object], data: bytes | str
) -> None:
    begin = time.monotonic()
    with pytest.raises((ProtocolError, PolicyFailedError)):
        decode(data)
    assert time.monotonic() - begin < SOON_S


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": 5}, r"`\$\.inputs`"),
        ({"inputs": [5]}, r"`\$\.inputs\[0\]`"),
        ({"inputs": [{"instruction": 1}]}, "instruction"),
        ({"views": {}}, r"`\$\.views`"),
        ({"views": [{"number": 0}]}, "rgb"),
        ({"type": "dance"}, "dance"),
        ({"type": "ground"}, "subtasks"),
    ],
)
def test_requests_of_wrong_types_are_named(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ProtocolError, match=words):
        decode_request(msgpack.packb(asked(**change)))


@pytest.mark.parametrize(
    "change",
    [
        {"dtype": "object"},
        {"dtype": "int32"},
        {"shape": []},
        {"shape": [1, 2, 3, 4]},
        {"shape": "wrong"},
        {"shape": -1},
        {"shape": 2**62},
        {"data": b"12"},
    ],
)
def test_damaged_arrays_are_refused(change: dict[str, Any]) -> None:
    for name in VIEW_ARRAYS:
        message = asked()
        array = message["views"][0][name]
        shape = array["shape"]
        array.update(change)
        if change.get("shape") == "wrong":
            array["shape"] = [n + 1 for n in shape]
        if isinstance(change.get("shape"), int):
            array["shape"] = [change["shape"] for _ in shape]
        request = decode_request(msgpack.packb(message))
        assert isinstance(request, Act)
        with pytest.raises(ProtocolError, match=f"array '{name}'"):
            request.views[0].read()


POSE = {"x": 0.0, "y": 0.0, "yaw": 0.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"subtask": None}, "subtask"),
        ({"subtask": {"robot": 0, "primitive": "move"}}, "robot"),
        ({"subtask": {"robot": "robot_0"}}, "primitive"),
        ({"subtask": {"robot": "robot_0", "primitive": "swim"}}, "swim"),
        ({"grounded": [0, 0, 0]}, "grounded"),
        ({"grounded": {"robot": None}}, "grounded"),
        *(
            ({"grounded": {**moved().grounded.to_dict(), "pick": pose}}, "pick")  # type: ignore[union-attr]
            for pose in (None, "0 0 0", [0.0], {"x": 0.0}, {**POSE, "y": "0"})
        ),
    ],
    ids=repr,
)
def test_decisions_are_checked(change: dict[str, Any], words: str) -> None:
    reply = plain(Decisions(decisions=[moved()]))
    reply["decisions"][0].update(change)
    with pytest.raises(PolicyFailedError, match=words) as failed:
        decode_reply(msgpack.packb(reply))
    unknown = words == "swim"
    assert failed.value.kind is (
        FaultKind.UNKNOWN_NAME if unknown else FaultKind.MALFORMED
    )


@pytest.mark.parametrize("answer", [5, None, {5}, np.zeros(3), ["move"], [{5}]])
def test_answers_of_policies_that_cannot_be_sent_are_malformed(answer: Any) -> None:
    with pytest.raises(PolicyFailedError) as failed:
        decode_reply(encode(Decisions(decisions=answer)))
    assert failed.value.kind is FaultKind.MALFORMED
