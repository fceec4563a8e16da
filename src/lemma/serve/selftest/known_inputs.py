"""Known inputs with known right answers: the self-test before a run.

A policy that reads quaternions in another order, mirrors yaw, or takes one robot for
the other runs without any error, and fails every episode. So the server is asked to say
in terms of the world what it was sent, and what it says is compared with the truth, and
where it differs, with what each of the usual mistakes would say.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lemma.env.view import View
from lemma.serve.client.conversation import Conversation
from lemma.serve.protocol.faults import PolicyFailedError
from lemma.serve.protocol.messages import (
    Message,
    decision_from_message,
    view_to_message,
)
from lemma.serve.selftest.echo import CELL_M
from lemma.serve.selftest.mistakes import (
    diagnose_colors,
    diagnose_lengths,
    diagnose_poses,
    diagnose_positions,
    diagnose_robots,
)

CHECKS = (
    "quaternion order",
    "yaw sign",
    "robot order",
    "pick and place",
    "units of length",
    "units of angle",
    "axes",
    "image orientation",
    "color order",
    "decision",
)
"""What is looked at."""
_CHECK_S = 30.0

ROBOTS = ("red robot", "white robot")
"""The first and the second."""
ROWS, COLUMNS = 288, 416
PATCHES: dict[tuple[float, float], tuple[tuple[int, int, int], float]] = {
    (0.8, 0.6): ((220, 40, 30), 0.05),
    (-0.8, 0.6): ((30, 60, 210), 0.10),
    (0.8, -0.6): ((40, 180, 60), 0.15),
    (-0.8, -0.6): ((230, 210, 40), 0.20),
}
"""What lies on the table: color and height [m] of a square around each point."""
CELLS = ((0, 0), (20, 300), (250, 30))
"""Cells of the map, row and column."""
POSES = ((0.31, -0.42, 0.3), (-0.55, 0.17, -0.9), (0.08, 0.64, 1.2))
"""Poses of a gripper that points down: x [m], y [m], yaw [rad]."""
JOINTS = np.array(
    [[0.1, -1.2, 1.3, -0.4, 1.5, 0.6], [-0.7, -0.8, 0.9, -1.0, -1.1, 2.2]]
)
OPENINGS_M = np.array([0.03, 0.07])
ORDER = {"robot": ROBOTS[1], "primitive": "move", "pick": 0, "place": 1}
"""What shall be put into a decision: the second robot moves something from the first
of :data:`POSES` to the second."""
PICK, PLACE = "red_cube", "blue_pad"


@dataclass(frozen=True)
class SelfTestReport:
    """What the self-test found."""

    where: str
    """Who was asked."""
    by: str
    """Who answered: ``"helper"``, the server of this package for its policy;
    ``"policy"``, the policy itself; or ``"nobody"``, if the server cannot."""
    mistakes: dict[str, str] = field(default_factory=dict)
    """Which of :data:`CHECKS` failed, and what was seen."""
    acts: str = ""
    """What its policy did in real scenes, if it was shown any."""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong, as far as it was tested."""
        return not self.mistakes

    def __str__(self) -> str:
        """Return all mistakes, or that there are none."""
        if self.ok:
            return f"{self.where}: no mistake was found."
        told = " ".join(
            f"{name.capitalize()}: {m}" for name, m in self.mistakes.items()
        )
        return f"{self.where} does not understand what it is sent. {told}"


def golden_view() -> View:
    """Return the view that is sent: four squares, each of its own color and height."""
    rgb = np.full((ROWS, COLUMNS, 3), 120, np.uint8)
    height_m = np.zeros((ROWS, COLUMNS), np.float32)
    half = 12
    for (x, y), (color, top_m) in PATCHES.items():
        row, column = round(ROWS / 2 - y / CELL_M), round(COLUMNS / 2 + x / CELL_M)
        patch = np.s_[row - half : row + half, column - half : column + half]
        rgb[patch] = color
        height_m[patch] = top_m
    coverage = np.ones((ROWS, COLUMNS), np.bool_)
    return View(rgb, height_m, coverage, JOINTS.copy(), OPENINGS_M.copy())


def golden_message() -> Message:
    """Return the message ``check``."""
    poses = [pose_message(*pose) for pose in POSES]
    return {
        "type": "check",
        "robots": list(ROBOTS),
        "view": view_to_message(golden_view()),
        "points": [list(point) for point in PATCHES],
        "cells": [list(cell) for cell in CELLS],
        "poses": poses,
        "order": {
            "robot": ORDER["robot"],
            "primitive": ORDER["primitive"],
            "pick": {"entity": PICK, **poses[0]},
            "place": {"entity": PLACE, **poses[1]},
        },
    }


def pose_message(x: float, y: float, yaw: float) -> Message:
    """Return the pose in space of a gripper that points down, as it is sent.

    Args:
        x: Position [m], world frame.
        y: Position [m], world frame.
        yaw: Direction of the gripper's x axis [rad].
    """
    half = 0.5 * yaw
    return {
        "position": [x, y, 0.02],
        "quaternion": [0.0, math.cos(half), math.sin(half), 0.0],
    }


def check(conversation: Conversation) -> SelfTestReport:
    """Ask a server what it understands, and name its mistakes.

    Raises:
        PolicyUnreachableError: Nobody answers.
        TimeoutError: There is no answer in time.
        OSError: The server is gone.
    """
    reply = conversation.ask(golden_message(), _CHECK_S)
    if reply["type"] == "error":
        text = str(reply.get("message"))
        if "not known" in text or reply.get("kind") == "unsupported":
            return SelfTestReport(conversation.where, "nobody")
        name = "quaternion order" if "point down" in text else "decision"
        return SelfTestReport(conversation.where, "helper", {name: text})
    mistakes: dict[str, str] = {}
    try:
        for found in _mistakes(reply):
            for name, text in found.items():
                mistakes.setdefault(name, text)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        what = f"{type(error).__name__}: {error}"
        mistakes["decision"] = f"The answer to 'check' cannot be read ({what})."
    return SelfTestReport(conversation.where, str(reply.get("by", "server")), mistakes)


def _mistakes(reply: Message) -> list[dict[str, str]]:
    positions = [
        ((column + 0.5 - COLUMNS / 2) * CELL_M, (ROWS / 2 - row - 0.5) * CELL_M)
        for row, column in CELLS
    ]
    joints = dict(zip(ROBOTS, JOINTS.tolist(), strict=True))
    openings = dict(zip(ROBOTS, OPENINGS_M.tolist(), strict=True))
    return [
        diagnose_poses(reply["poses"], POSES, "It reads the pose"),
        diagnose_positions(reply["positions"], positions),
        diagnose_colors(reply["colors"], {p: c for p, (c, _) in PATCHES.items()}),
        diagnose_lengths(reply["heights_m"], {p: h for p, (_, h) in PATCHES.items()}),
        diagnose_robots(reply["joints"], joints, reply["openings_m"], openings),
        _diagnose_decision(reply["decision"]),
    ]


def _diagnose_decision(answer: dict[str, Any]) -> dict[str, str]:
    """Return what is wrong with the decision into which an order was put."""
    try:
        decision = decision_from_message(answer)
    except PolicyFailedError as error:
        text = str(error)
        name = "quaternion order" if "quaternion" in text else "decision"
        return {name: f"Its decision cannot be read: {text}"}
    subtask, grounded = decision.subtask, decision.grounded
    if grounded is None:
        return {"decision": "Its decision has no poses."}
    found: dict[str, str] = {}
    robots = {subtask.robot, grounded.robot}
    if robots != {"robot_1"}:
        found["robot order"] = (
            f"Told to use the second robot ({ROBOTS[1]}), it decides for "
            f"{', '.join(sorted(robots))} instead of robot_1."
        )
    given = [[p.x, p.y, p.yaw] for p in (grounded.pick, grounded.place)]
    swapped = diagnose_poses(given[::-1], POSES[:2], "")
    wrong = diagnose_poses(given, POSES[:2], "It writes the pose")
    if (subtask.pick, subtask.place) == (PLACE, PICK) or (wrong and not swapped):
        found["pick and place"] = (
            f"Told to pick {PICK} and to place it on {PLACE}, it answers the other way "
            "round."
        )
        return found
    if (str(subtask.primitive), subtask.pick, subtask.place) != ("move", PICK, PLACE):
        found["decision"] = f"Told to move {PICK} to {PLACE}, it decides: {subtask}."
    return {**wrong, **found}
