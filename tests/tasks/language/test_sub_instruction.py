"""Sub-tasks in words: entities, robots and primitives."""

from dataclasses import replace

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.scene.spec import RobotPlacement
from lemma.tasks.language import bank as language
from lemma.tasks.suite import SUITE, load_instance


@pytest.mark.parametrize(
    ("entity", "expected"),
    [
        ("red_cube", "red cube"),
        ("white_pad", "white pad"),
        ("stick", "yellow stick"),
        ("shared", "shared space"),
    ],
)
def test_phrase(entity, expected):
    assert language.phrase(entity) == expected


@pytest.mark.parametrize("entity", ["red", "red_bowl", "yellow_cube", "red_cube_2", ""])
def test_phrase_refuses_what_is_no_entity(entity):
    with pytest.raises(UnknownNameError, match="entity"):
        language.phrase(entity)


@pytest.mark.parametrize(
    ("colors", "expected"),
    [
        (("red",), ("red robot",)),
        (("red", "white"), ("red robot", "white robot")),
        (("white", "white"), ("left white robot", "right white robot")),
        (
            ("red", "white", "red"),
            ("left red robot", "white robot", "right red robot"),
        ),
        (
            ("red", "red", "red"),
            ("first red robot", "second red robot", "third red robot"),
        ),
    ],
)
def test_robot_phrases_tell_robots_apart(colors, expected):
    assert language.robot_phrases_in_order(colors) == expected


def test_robot_phrases_end_somewhere():
    with pytest.raises(InvalidConfigError, match="up to 6 are counted"):
        language.robot_phrases_in_order(("red",) * 7)


def team(*places: tuple[float, float]) -> list[RobotPlacement]:
    return [RobotPlacement("ur5", "red", Pose2(x, y)) for x, y in places]


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        # Listed from right to left.
        (((0.9, 0.0), (-0.9, 0.0)), ("right red robot", "left red robot")),
        # A team along y: the map shows one above the other.
        (((0.02, 0.9), (0.0, -0.9)), ("upper red robot", "lower red robot")),
        (
            ((0.9, 0.0), (0.0, 0.9), (-0.9, 0.0)),
            ("third red robot", "second red robot", "first red robot"),
        ),
    ],
)
def test_robots_are_told_apart_by_where_they_stand(places, expected):
    assert language.robot_phrases(team(*places)) == expected


def test_robots_of_two_colors_are_left_and_right_among_their_own():
    red, white, other = team((0.9, 0.0), (0.0, 0.9), (-0.9, 0.0))
    robots = (red, replace(white, color="white"), other)
    phrases = language.robot_phrases(robots)
    assert phrases == ("right red robot", "white robot", "left red robot")


def test_robots_in_a_square_cannot_be_counted_from_the_left():
    corners = team((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))
    with pytest.raises(InvalidConfigError, match="no words tell them apart"):
        language.robot_phrases(corners)


@pytest.mark.parametrize("task", SUITE)
def test_left_and_right_are_where_the_benchmark_lists_them(task):
    for index in range(20):
        robots = load_instance(task, "train", index).scene.robots
        colors = tuple(robot.color for robot in robots)
        by_order = language.robot_phrases_in_order(colors)
        assert language.robot_phrases(robots) == by_order


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ("white robot", "move", "red_cube", "shared"),
            "white robot: move the red cube to the shared space",
        ),
        (
            ("red robot", "move", "red_cube", "white_pad"),
            "red robot: move the red cube onto the white pad",
        ),
        (
            ("left red robot", "move", "stick", "shared"),
            "left red robot: move the yellow stick to the shared space",
        ),
        (
            ("red robot", "prehook", "stick", "blue_cube"),
            "red robot: put the yellow stick behind the blue cube",
        ),
        (
            ("red robot", "hook", "blue_cube", "shared"),
            "red robot: hook the blue cube with the yellow stick",
        ),
        (
            ("red robot", "prepoke", "stick", "blue_cube"),
            "red robot: put the yellow stick in front of the blue cube",
        ),
        (
            ("red robot", "poke", "stick", "blue_cube"),
            "red robot: poke the blue cube with the yellow stick",
        ),
        (("red robot", "stop"), "done"),
    ],
)
def test_sub_instruction(words, expected):
    assert language.sub_instruction(*words) == expected


def test_a_bad_sub_task_is_refused_with_a_reason():
    with pytest.raises(UnknownNameError, match="Did you mean 'prehook'"):
        language.sub_instruction("red robot", "prehok", "stick", "blue_cube")
    with pytest.raises(UnknownNameError, match="move, prehook, hook, prepoke, poke, s"):
        language.sub_instruction("red robot", "move_to_shared", "stick", "blue_cube")
    with pytest.raises(InvalidConfigError, match="needs pick and place"):
        language.sub_instruction("red robot", "move", "blue_cube")
    with pytest.raises(InvalidConfigError, match="acts on one cube"):
        language.sub_instruction("red robot", "hook", "stick", "shared")
