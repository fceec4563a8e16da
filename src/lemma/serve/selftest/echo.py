"""What a server says that it understood, for the self-test before a run."""

import math
from collections.abc import Mapping
from typing import Any

from lemma.core.robot_names import robot_name
from lemma.env.view import View
from lemma.serve.protocol.faults import ProtocolError
from lemma.serve.protocol.messages import (
    Message,
    entries,
    pose_from_message,
    view_from_message,
)

CELL_M = 0.008
"""Side of a cell of the map [m]; see :mod:`lemma.scene.topdown_map`."""


def cell_of(view: View, x: float, y: float) -> tuple[int, int]:
    """Return row and column of the cell of the map that holds a point.

    Args:
        view: With the map.
        x: Position [m], world frame.
        y: Position [m], world frame.
    """
    rows, columns = view.height_m.shape
    return math.floor(rows / 2 - y / CELL_M), math.floor(columns / 2 + x / CELL_M)


def position_of(view: View, row: int, column: int) -> tuple[float, float]:
    """Return the position [m], world frame, of the centre of a cell of the map."""
    rows, columns = view.height_m.shape
    return (column + 0.5 - columns / 2) * CELL_M, (rows / 2 - row - 0.5) * CELL_M


def echo(policy: object, message: Message) -> Message:
    """Answer a ``check`` message: describe what was sent in terms of the world.

    A policy with a method ``describe(message)`` has the last word: what it returns
    replaces entries of the answer, so that its own conversions are tested too.

    Raises:
        ProtocolError: Something is missing.
    """
    view = view_from_message(message["view"])
    robots = entries(message, "robots")
    if len(robots) != len(view.joints):
        raise ProtocolError(f"{len(robots)} robots, but joints of {len(view.joints)}.")
    cells = [cell_of(view, x, y) for x, y in entries(message, "points")]
    poses = [pose_from_message(pose) for pose in entries(message, "poses")]
    answer: Message = {
        "type": "checked",
        "by": "helper",
        "colors": [view.rgb[cell].tolist() for cell in cells],
        "heights_m": [float(view.height_m[cell]) for cell in cells],
        "positions": [position_of(view, *cell) for cell in entries(message, "cells")],
        "poses": [[pose.x, pose.y, pose.yaw] for pose in poses],
        "joints": {
            robot: row.tolist() for robot, row in zip(robots, view.joints, strict=True)
        },
        "openings_m": dict(zip(robots, view.opening_m.tolist(), strict=True)),
        "decision": _ordered(message["order"], robots),
    }
    describe = getattr(policy, "describe", None)
    return answer if describe is None else {**answer, **_described(describe, message)}


def _ordered(order: Mapping[str, Any], robots: list[str]) -> Message:
    """Return an order in plain words as a decision."""
    robot = robot_name(robots.index(order["robot"]))
    pick, place = order["pick"], order["place"]
    poses = (pose_from_message(end) for end in (pick, place))
    ends = [[pose.x, pose.y, pose.yaw] for pose in poses]
    primitive = order["primitive"]
    return {
        "subtask": {
            "robot": robot,
            "primitive": primitive,
            "pick": pick["entity"],
            "place": place["entity"],
        },
        "grounded": {
            "robot": robot,
            "primitive": primitive,
            "pick": ends[0],
            "place": ends[1],
        },
        "explanation": "",
    }


def _described(describe: Any, message: Message) -> Message:
    return {**describe(message), "by": "policy"}
