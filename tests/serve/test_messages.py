"""What is said arrives as it was said, to the bit; what is no message is refused."""

import math
from typing import Any

import numpy as np
import pytest
from faulty_policies import MOVE, moved, view
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lemma.core.poses import Pose2
from lemma.policies.interfaces import Decision
from lemma.serve.protocol.faults import FaultKind, PolicyFailedError, ProtocolError
from lemma.serve.protocol.messages import (
    VIEW_TYPES,
    decision_from_message,
    decision_to_message,
    pose_from_message,
    view_from_message,
    view_to_message,
)
from lemma.serve.protocol.packing import DTYPES, pack, unpack
from lemma.serve.selftest.known_inputs import pose_message
from lemma.tasks.subtask import STOP, GroundedSubTask


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(DTYPES).flatmap(
        lambda name: arrays.arrays(
            np.dtype(name), arrays.array_shapes(min_dims=0, max_dims=4, min_side=0)
        )
    )
)
def test_arrays_keep_type_shape_and_bits(array: np.ndarray) -> None:
    [found] = unpack(pack({"type": "x", "arrays": [array]}))["arrays"]
    assert (found.dtype, found.shape) == (array.dtype, array.shape)
    assert found.tobytes() == array.tobytes()


def test_arrays_of_other_layouts_arrive_in_order() -> None:
    array = np.arange(12.0).reshape(3, 4).T
    swapped = array.astype(">f8")
    found = unpack(pack({"type": "x", "a": array, "b": swapped}))
    assert np.array_equal(found["a"], array)
    assert np.array_equal(found["b"], array)


def test_views_and_decisions_arrive() -> None:
    sent = view(7)
    found = view_from_message(
        unpack(pack({"type": "x", "view": view_to_message(sent)}))["view"]
    )
    for name in VIEW_TYPES:
        assert np.array_equal(getattr(found, name), getattr(sent, name))
        assert getattr(found, name).dtype == getattr(sent, name).dtype
    for decision in (moved(), Decision(STOP, None), Decision(MOVE, None, "lost")):
        message = unpack(pack({"type": "x", "d": decision_to_message(decision)}))["d"]
        assert decision_from_message(message) == decision


@pytest.mark.parametrize(
    "data",
    [
        "text",
        b"",
        b"\xc1",
        b"\x93\x01\x02\x03",
        pack({"type": "x", "a": 1})[:-1],
        b"\x81\xa4type\x05",
    ],
)
def test_what_is_no_message_is_refused(data: bytes | str) -> None:
    with pytest.raises(ProtocolError):
        unpack(data)


@pytest.mark.parametrize(
    "array",
    [
        {"dtype": "object", "shape": [1], "data": b"12345678"},
        {"dtype": "uint8", "shape": [3], "data": b"12"},
        {"dtype": "float32", "shape": [1], "data": b"123"},
        {"dtype": "uint8", "shape": ["a"], "data": b"12"},
        {"dtype": "uint8", "shape": [2], "data": "12"},
    ],
)
def test_damaged_arrays_are_refused(array: dict[str, Any]) -> None:
    with pytest.raises(ProtocolError, match="array"):
        unpack(pack({"type": "x", "a": array}))


def test_only_plain_data_is_sent() -> None:
    for value in (object(), np.array(["a"]), moved()):
        with pytest.raises(ProtocolError, match="cannot be sent"):
            pack({"type": "x", "a": value})
    assert unpack(pack({"type": "x", "a": np.float32(0.5)}))["a"] == 0.5


@pytest.mark.parametrize("name", sorted(VIEW_TYPES))
def test_views_are_checked(name: str) -> None:
    message = view_to_message(view())
    wrong = message[name].astype(np.int32)
    for changed in ({**message, name: wrong}, {**message, name: message[name][None]}):
        with pytest.raises(ProtocolError, match=name):
            view_from_message(changed)
    del message[name]
    with pytest.raises(ProtocolError, match=f"lacks the array '{name}'"):
        view_from_message(message)


@pytest.mark.parametrize("yaw", [0.0, 0.3, -0.9, 3.0, -3.1])
def test_poses_in_space_are_those_in_the_plane(yaw: float) -> None:
    pose = pose_from_message(pose_message(0.1, -0.2, yaw))
    assert (pose.x, pose.y) == (0.1, -0.2)
    assert abs(math.remainder(pose.yaw - yaw, 2.0 * math.pi)) < 1e-12
    # The other sign of a quaternion is the same rotation.
    message = pose_message(0.1, -0.2, yaw)
    message["quaternion"] = [-v for v in message["quaternion"]]
    assert pose_from_message(message).yaw == pytest.approx(pose.yaw)
    assert pose_from_message([0.1, -0.2, yaw]) == Pose2(0.1, -0.2, yaw)
    # Read as x, y, z, w this gripper does not point down, except near half a turn.
    if abs(yaw) > 2.0:
        return
    message["quaternion"] = [*message["quaternion"][1:], message["quaternion"][0]]
    with pytest.raises(PolicyFailedError, match="w, x, y, z"):
        pose_from_message(message)


@pytest.mark.parametrize(
    "pose",
    [
        None,
        "0 0 0",
        [0.0, 0.0],
        [0.0, 0.0, "0"],
        [0.0, 0.0, True],
        {"position": [0.0, 0.0, 0.0]},
        {"position": [0.0, 0.0, 0.0], "quaternion": [0.0, 2.0, 0.0, 0.0]},
        {"position": [0.0, 0.0], "quaternion": [0.0, 1.0, 0.0, 0.0]},
    ],
)
def test_what_is_no_pose_is_named(pose: object) -> None:
    with pytest.raises(PolicyFailedError) as failed:
        pose_from_message(pose)
    assert failed.value.kind is FaultKind.MALFORMED


def test_numbers_that_are_none_pass_to_whoever_judges_them() -> None:
    pose = pose_from_message([math.nan, 0.0, 0.0])
    assert math.isnan(pose.x)
    space = {"position": [0.0, 0.0, 0.0], "quaternion": [math.nan] * 4}
    assert math.isnan(pose_from_message(space).yaw)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"subtask": None}, FaultKind.MALFORMED),
        ({"subtask": {"robot": 0, "primitive": "move"}}, FaultKind.MALFORMED),
        ({"subtask": {"robot": "robot_0"}}, FaultKind.UNKNOWN_NAME),
        ({"grounded": [0, 0, 0]}, FaultKind.MALFORMED),
        ({"grounded": {"robot": None}}, FaultKind.MALFORMED),
    ],
)
def test_decisions_are_checked(change: dict[str, Any], kind: FaultKind) -> None:
    with pytest.raises(PolicyFailedError) as failed:
        decision_from_message({**decision_to_message(moved()), **change})
    assert failed.value.kind is kind


def test_what_a_policy_returns_is_checked_before_it_is_sent() -> None:
    pose = Pose2(0.0, 0.0, 0.0)
    for wrong in (
        "move",
        Decision("move", None),  # type: ignore[arg-type]
        Decision(MOVE, (0, 0, 0)),  # type: ignore[arg-type]
        Decision(MOVE, GroundedSubTask("robot_0", MOVE.primitive, pose, (0, 0, 0))),  # type: ignore[arg-type]
    ):
        with pytest.raises(PolicyFailedError, match="is no"):
            decision_to_message(wrong)  # type: ignore[arg-type]
