"""The self-test names every usual mistake, of servers that make it on purpose."""

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from faulty_policies import Scripted

from lemma.scene.raster import RASTER
from lemma.serve.client.conversation import ProtocolMode
from lemma.serve.client.websocket import connect
from lemma.serve.protocol.messages import Message
from lemma.serve.selftest.echo import CELL_M, cell_of, echo, position_of
from lemma.serve.selftest.known_inputs import (
    CHECKS,
    SelfTestReport,
    check,
    golden_message,
    golden_view,
)
from lemma.serve.server.server import PolicyServer


class Describes(Scripted):
    """Reads and writes with a mistake."""

    def __init__(
        self,
        reads: Callable[[Message], Any] = lambda message: None,
        writes: Callable[[Message], Any] = lambda answer: None,
    ) -> None:
        self.reads, self.writes = reads, writes

    def describe(self, message: Message) -> Message:
        message = copy.deepcopy(message)
        self.reads(message)
        answer = echo(None, message)
        self.writes(answer)
        return answer


def report_of(policy: object) -> SelfTestReport:
    with PolicyServer(policy, port=0) as server:
        remote = connect(server.url, ProtocolMode(30.0))
        try:
            return check(remote.conversation)
        finally:
            remote.close()


def image(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Message], None]:
    def reads(message: Message) -> None:
        for name in ("rgb", "height_m"):
            message["view"][name] = change(message["view"][name])

    return reads


def bgr(message: Message) -> None:
    message["view"]["rgb"] = message["view"]["rgb"][..., ::-1]


def robots_swapped(message: Message) -> None:
    message["robots"] = message["robots"][::-1]


def joints_of_the_other(message: Message) -> None:
    message["view"]["joints"] = message["view"]["joints"][::-1]


def openings_of_the_other(message: Message) -> None:
    message["view"]["opening_m"] = message["view"]["opening_m"][::-1]


def naive_yaw(quaternion: list[float]) -> float:
    x, y, z, w = quaternion
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def xyzw_read(answer: Message) -> None:
    answer["poses"] = [
        [*pose["position"][:2], naive_yaw(pose["quaternion"])]
        for pose in golden_message()["poses"]
    ]


def poses_of(answer: Message) -> list[list[float]]:
    grounded = answer["decision"]["grounded"]
    return [*answer["poses"], grounded["pick"], grounded["place"]]


def each_pose(change: Callable[[list[float]], None]) -> Callable[[Message], None]:
    def writes(answer: Message) -> None:
        for pose in poses_of(answer):
            change(pose)

    return writes


def mirrored_yaw(pose: list[float]) -> None:
    pose[2] = -pose[2]


def degrees(pose: list[float]) -> None:
    pose[2] = math.degrees(pose[2])


def quarter_turn(pose: list[float]) -> None:
    pose[2] += math.pi / 2


def millimetres(pose: list[float]) -> None:
    pose[0], pose[1] = 1000.0 * pose[0], 1000.0 * pose[1]


def axes_swapped(pose: list[float]) -> None:
    pose[0], pose[1] = pose[1], pose[0]


def mirrored_y(pose: list[float]) -> None:
    pose[1] = -pose[1]


def xyzw_written(answer: Message) -> None:
    for end, pose in zip(("pick", "place"), golden_message()["poses"][:2], strict=True):
        w, x, y, z = pose["quaternion"]
        answer["decision"]["grounded"][end] = {**pose, "quaternion": [x, y, z, w]}


def ends_swapped(answer: Message) -> None:
    grounded = answer["decision"]["grounded"]
    grounded["pick"], grounded["place"] = grounded["place"], grounded["pick"]


def names_swapped(answer: Message) -> None:
    subtask = answer["decision"]["subtask"]
    subtask["pick"], subtask["place"] = subtask["place"], subtask["pick"]


def first_robot(answer: Message) -> None:
    for part in ("subtask", "grounded"):
        answer["decision"][part]["robot"] = "robot_0"


def joints_in_degrees(answer: Message) -> None:
    answer["joints"] = {
        robot: np.degrees(row).tolist() for robot, row in answer["joints"].items()
    }


def heights_in_millimetres(answer: Message) -> None:
    answer["heights_m"] = [1000.0 * height for height in answer["heights_m"]]


def openings_in_millimetres(answer: Message) -> None:
    answer["openings_m"] = {r: 1000.0 * v for r, v in answer["openings_m"].items()}


def cells_from_below(answer: Message) -> None:
    answer["positions"] = [[x, -y] for x, y in answer["positions"]]


def corners(answer: Message) -> None:
    answer["positions"] = [[x - 0.004, y + 0.004] for x, y in answer["positions"]]


def another_primitive(answer: Message) -> None:
    answer["decision"]["subtask"]["primitive"] = "hook"


MISTAKES: dict[str, tuple[dict[str, Any], str, str]] = {
    "quaternions read as xyzw": ({"writes": xyzw_read}, "quaternion order", "w, x, y"),
    "quaternions written as xyzw": (
        {"writes": xyzw_written},
        "quaternion order",
        "w, x, y, z",
    ),
    "yaw mirrored": (
        {"writes": each_pose(mirrored_yaw)},
        "yaw sign",
        "counter-clockwise",
    ),
    "yaw along the other axis": ({"writes": each_pose(quarter_turn)}, "axes", "x axis"),
    "robots swapped": ({"reads": robots_swapped}, "robot order", "other robot's"),
    "joints of the other": (
        {"reads": joints_of_the_other},
        "robot order",
        "other robot's",
    ),
    "openings of the other": (
        {"reads": openings_of_the_other},
        "robot order",
        "other robot's",
    ),
    "decides for the first": ({"writes": first_robot}, "robot order", "robot_1"),
    "BGR": ({"reads": bgr}, "color order", "BGR"),
    "upside down": (
        {"reads": image(lambda a: a[::-1])},
        "image orientation",
        "upside down",
    ),
    "left to right": (
        {"reads": image(lambda a: a[:, ::-1])},
        "image orientation",
        "column 0",
    ),
    "turned": (
        {"reads": image(lambda a: a[::-1, ::-1])},
        "image orientation",
        "half a turn",
    ),
    "cells from below": ({"writes": cells_from_below}, "image orientation", "row 0"),
    "corners of cells": ({"writes": corners}, "image orientation", "middle"),
    "poses in millimetres": (
        {"writes": each_pose(millimetres)},
        "units of length",
        "millimetres",
    ),
    "heights in millimetres": (
        {"writes": heights_in_millimetres},
        "units of length",
        "metres",
    ),
    "openings in millimetres": (
        {"writes": openings_in_millimetres},
        "units of length",
        "metres",
    ),
    "degrees": ({"writes": each_pose(degrees)}, "units of angle", "degrees"),
    "joints in degrees": ({"writes": joints_in_degrees}, "units of angle", "degrees"),
    "x and y swapped": ({"writes": each_pose(axes_swapped)}, "axes", "swapped"),
    "y mirrored": ({"writes": each_pose(mirrored_y)}, "axes", "mirrored"),
    "poses of pick and place swapped": (
        {"writes": ends_swapped},
        "pick and place",
        "other way",
    ),
    "names of pick and place swapped": (
        {"writes": names_swapped},
        "pick and place",
        "other way",
    ),
    "another primitive": ({"writes": another_primitive}, "decision", "hook"),
    "no numbers": (
        {"writes": lambda answer: answer.update(poses=[["a"] * 3])},
        "decision",
        "cannot be read",
    ),
    "nothing": (
        {"writes": lambda answer: answer.update(colors=None)},
        "decision",
        "cannot be read",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(mistake: str) -> None:
    how, name, words = MISTAKES[mistake]
    report = report_of(Describes(**how))
    assert report.by == "policy"
    # This one, and no other.
    assert list(report.mistakes) == [name], str(report)
    assert words in report.mistakes[name]
    assert name in CHECKS
    assert name.capitalize() in str(report)


def test_two_mistakes_are_both_named() -> None:
    def both(message: Message) -> None:
        bgr(message)
        image(lambda a: a[::-1])(message)

    report = report_of(Describes(reads=both, writes=each_pose(mirrored_yaw)))
    assert set(report.mistakes) == {"color order", "image orientation", "yaw sign"}


def test_a_right_server_passes() -> None:
    assert report_of(Describes()).ok
    helper = report_of(Scripted())
    assert helper.ok
    assert helper.by == "helper"


def test_a_server_that_refuses_is_told_apart_from_one_that_cannot() -> None:
    def upset(message: Message) -> None:
        raise ValueError("the gripper does not point down")

    assert list(report_of(Describes(reads=upset)).mistakes) == ["quaternion order"]


def test_the_truth_of_the_test_is_that_of_the_map() -> None:
    view = golden_view()
    assert view.height_m.shape == (RASTER.rows, RASTER.columns)
    assert RASTER.cell_m == CELL_M
    for row, column in ((0, 0), (100, 300), (287, 415)):
        assert position_of(view, row, column) == RASTER.world_from_pixel(row, column)
    for x, y in ((0.8, 0.6), (-1.2, 0.333), (0.0, -1.1)):
        assert cell_of(view, x, y) == RASTER.pixel_from_world(x, y)
