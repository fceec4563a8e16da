"""Sticks that are laid beside the object that they shall drag."""

import math
from typing import Any

import pytest

from lemma.core.poses import Pose2
from lemma.tasks.drags import find_drag
from lemma.tasks.subtask import Primitive
from lemma.tasks.suite import load_instance
from measure_laid_sticks import COLUMNS, laid

INSTANCE = load_instance("hook", "test", 0)
NAME = INSTANCE.goal.pairs[0][0]
CUBE = next(one.pose for one in INSTANCE.scene.objects if one.name == NAME)
DRAGS = [
    drag
    for robot in INSTANCE.scene.robots
    if (drag := find_drag(Primitive.HOOK, robot, robot, CUBE, ()))
]


def episode(place: Pose2, departure: str = "") -> dict[str, Any]:
    known = {"task": "hook", "split": "test", "index": 0}
    expert = {"departure": departure}
    lays = {"primitive": "prehook", "pick": "yellow_stick", "place": NAME}
    at = [place.x, place.y, place.yaw]
    done = {"outcome": "success", "grounded": {"place": at}, "expert": expert}
    return {**known, "subtasks": [{**lays, **done}]}


def test_one_robot_can_drag_the_cube() -> None:
    assert len(DRAGS) == 1


@pytest.mark.parametrize(
    ("off", "columns"),
    [
        (Pose2(0.0, 0.0), COLUMNS[:1]),
        (Pose2(0.0, 0.0, 0.3), COLUMNS[:3]),
        (Pose2(0.1, 0.0), COLUMNS[:2]),
        (Pose2(0.0, 0.3), COLUMNS[:2]),
    ],
)
def test_a_missed_stick_is_only_turned_if_another_yaw_would_do(
    off: Pose2, columns: tuple[str, ...]
) -> None:
    place = DRAGS[0].prepared @ off
    assert [column for _, column in laid(episode(place))] == [*columns]


def test_sticks_of_oblique_instances_count_twice() -> None:
    beside = episode(DRAGS[0].prepared @ Pose2(0.0, 0.3))
    found = [column for _, column in laid(beside, {("hook", 0)})]
    assert found == [*COLUMNS[:2], *COLUMNS[3:]]


def test_a_sub_task_that_the_expert_has_not_does_not_count() -> None:
    beside = Pose2(CUBE.x, CUBE.y, math.pi)
    assert not list(laid(episode(beside, "wrong_order")))
