"""Valid scenes, and errors for invalid ones."""

import math
from typing import Any

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec

HERE = Pose2(0.1, 0.2, 0.3)


def test_entities_are_named_by_color_and_kind() -> None:
    assert ObjectPlacement("cube", "red", HERE).name == "red_cube"
    assert ObjectPlacement("pad", "white", HERE).name == "white_pad"
    assert ObjectPlacement("stick", "yellow", HERE).name == "stick"


@pytest.mark.parametrize(
    ("placement", "names", "message"),
    [
        (
            ObjectPlacement,
            ("cube", "rad"),
            "color 'rad'. Did you mean 'red'? Valid: ",
        ),
        (ObjectPlacement, ("ball", "red"), "object kind 'ball'. Valid: cube, pad, "),
        (RobotPlacement, ("ur50", "red"), "arm 'ur50'. Did you mean 'ur5'?"),
        (RobotPlacement, ("ur5", "pink"), "robot color 'pink'. Valid: red, white"),
    ],
)
def test_an_unknown_name_is_answered(
    placement: Any, names: tuple[str, str], message: str
) -> None:
    with pytest.raises(UnknownNameError) as caught:
        placement(*names, HERE)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "color", "name"),
    [("cube", "red", "red_cube"), ("stick", "yellow", "stick")],
)
def test_one_name_is_one_object(kind: str, color: str, name: str) -> None:
    twice = tuple(ObjectPlacement(kind, color, Pose2(x, 0.0)) for x in (0.0, 0.5))
    with pytest.raises(InvalidConfigError) as caught:
        SceneSpec((), twice)
    assert f"named twice in one scene: {name}." in str(caught.value)
    assert "choose another color" in str(caught.value)


def test_a_cube_and_a_pad_may_share_a_color() -> None:
    spec = SceneSpec(
        (), tuple(ObjectPlacement(kind, "red", HERE) for kind in ("cube", "pad"))
    )
    assert spec.object_names == ("red_cube", "red_pad")
    assert spec.placement("red_pad").kind == "pad"


def test_what_is_not_there_is_answered() -> None:
    spec = SceneSpec((), (ObjectPlacement("cube", "red", HERE),))
    with pytest.raises(UnknownNameError, match=r"'red_cub'.*mean 'red_cube'"):
        spec.placement("red_cub")


def test_robots_are_counted_from_the_first() -> None:
    robots = tuple(
        RobotPlacement("ur5", "red", Pose2(x, 0.0, math.pi)) for x in (0.0, 1.0, 2.0)
    )
    assert SceneSpec(robots, ()).robot_names == ("robot_0", "robot_1", "robot_2")
