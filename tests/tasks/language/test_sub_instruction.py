"""Sub-tasks in words: entities, robots and primitives."""

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.tasks.language import bank as language


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
    assert language.robot_phrases(colors) == expected


def test_robot_phrases_end_somewhere():
    with pytest.raises(InvalidConfigError, match="at most 6"):
        language.robot_phrases(("red",) * 7)


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
