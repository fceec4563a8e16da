"""Sub-tasks are plain data that read well."""

import json

import pytest

from lemma.core.poses import Pose2
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask


@pytest.mark.parametrize(
    "subtask",
    [
        STOP,
        SubTask("robot_0", Primitive.MOVE, "red_cube", "shared"),
        SubTask("robot_1", Primitive.HOOK, "stick", "blue_cube"),
    ],
)
def test_a_sub_task_survives_json(subtask: SubTask) -> None:
    assert SubTask.from_dict(json.loads(json.dumps(subtask.to_dict()))) == subtask


def test_a_sub_task_reads_well() -> None:
    subtask = SubTask("robot_1", Primitive.MOVE, "red_cube", "white_pad")
    assert str(subtask) == "robot_1 move red_cube -> white_pad"
    assert str(STOP) == "stop"


def test_an_unknown_primitive_is_refused() -> None:
    with pytest.raises(ValueError, match="'throw'"):
        Primitive("throw")


def test_a_grounded_sub_task_is_plain_data() -> None:
    grounded = GroundedSubTask(
        "robot_0", Primitive.POKE, Pose2(0.1, 0.2, 0.3), Pose2(0.4, 0.5, 0.6)
    )
    assert json.loads(json.dumps(grounded.to_dict())) == {
        "robot": "robot_0",
        "primitive": "poke",
        "pick": [0.1, 0.2, 0.3],
        "place": [0.4, 0.5, 0.6],
    }
    assert GroundedSubTask.from_dict(json.loads(json.dumps(grounded.to_dict()))) == (
        grounded
    )
