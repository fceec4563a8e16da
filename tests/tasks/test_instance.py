"""Instances are plain data: they survive JSON, and their key and hash name them."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.spec import ROBOT_COLORS, ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import BENCHMARK_VERSION, OWN_SPLIT, SPLITS, Instance

COLORS = tuple(OBJECT_COLORS)
poses = st.builds(
    Pose2, st.floats(-1.5, 1.5), st.floats(-1.1, 1.1), st.floats(-math.pi, math.pi)
)
robots = st.builds(
    RobotPlacement,
    st.sampled_from(["ur5", "ur10"]),
    st.sampled_from(ROBOT_COLORS),
    poses,
)


@st.composite
def instances(draw: st.DrawFn) -> Instance:
    cubes = draw(st.lists(st.sampled_from(COLORS), min_size=2, unique=True))
    pads = draw(st.lists(st.sampled_from(COLORS), unique=True))
    objects = [ObjectPlacement("cube", color, draw(poses)) for color in cubes]
    objects += [ObjectPlacement("pad", color, draw(poses)) for color in pads]
    if draw(st.booleans()):
        objects.append(ObjectPlacement("stick", "yellow", draw(poses)))
    return Instance(
        task=draw(st.sampled_from(["stack", "hook"])),
        split=draw(st.sampled_from([*SPLITS, "free"])),
        index=draw(st.integers(0, 10**9)),
        scene=SceneSpec((draw(robots), draw(robots)), tuple(objects)),
        goal=Goal.from_pairs(((f"{cubes[0]}_cube", f"{cubes[1]}_cube"),)),
        instructions={"high_level": draw(st.text()), "human": draw(st.text())},
        distractors=tuple(placed.name for placed in objects[2:]),
    )


@given(instances())
def test_an_instance_survives_json(instance: Instance) -> None:
    text = json.dumps(instance.to_dict())
    back = Instance.from_dict(json.loads(text))
    assert back == instance
    assert back.to_dict() == instance.to_dict()
    assert back.sha256() == instance.sha256()


@given(instances())
def test_the_key_says_what_the_instance_is(instance: Instance) -> None:
    version, task, split, index = instance.key.split("/")
    assert version == BENCHMARK_VERSION == instance.to_dict()["version"]
    assert (task, split, int(index)) == (instance.task, instance.split, instance.index)


@given(instances())
def test_any_change_changes_the_hash(instance: Instance) -> None:
    first, second = instance.scene.robots
    moved = Pose2(first.base.x, first.base.y, first.base.yaw + 1e-4)
    scene = replace(instance.scene, robots=(replace(first, base=moved), second))
    changed: list[dict[str, Any]] = [
        {"index": instance.index + 1},
        {"split": "other"},
        {"scene": scene},
        {"instructions": {**instance.instructions, "human": "x" * 99}},
        {"goal": Goal.from_pairs(tuple(pair[::-1] for pair in instance.goal.pairs))},
    ]
    hashes = {replace(instance, **change).sha256() for change in changed}
    assert len(hashes | {instance.sha256()}) == 6


@pytest.mark.parametrize(
    ("arms", "team"),
    [
        (("ur5", "ur5"), "ur5+ur5"),
        (("ur5", "ur10"), "ur5+ur10"),
        (("ur10", "ur5"), "ur5+ur10"),
        (("ur10", "ur10"), "ur10+ur10"),
    ],
)
def test_a_team_is_named_from_small_to_large(arms: tuple[str, str], team: str) -> None:
    left, right = (
        RobotPlacement(arm, "red", Pose2(x, 0.0))
        for arm, x in zip(arms, (-1.0, 1.0), strict=True)
    )
    cubes = tuple(
        ObjectPlacement("cube", color, Pose2(x, 0.0))
        for color, x in (("red", 0.0), ("blue", 0.3))
    )
    scene = SceneSpec((left, right), cubes)
    goal = Goal.from_pairs((("red_cube", "blue_cube"),))
    assert Instance("stack", "free", 0, scene, goal, {}, ()).team == team


@pytest.mark.parametrize(
    ("pair", "what"),
    [
        (("red_pad", "blue_pad"), "top must be something that can be put somewhere"),
        (("stick", "blue_pad"), "top must be something that can be put somewhere"),
        (("red_cube", "red_cube"), "not the bottom itself"),
        (("red_cube", "stick"), "nothing can lie on the bottom"),
    ],
)
def test_what_cannot_be_stacked_is_no_goal(pair: tuple[str, str], what: str) -> None:
    with pytest.raises(InvalidConfigError, match=what):
        Goal.from_pairs((pair,))


def test_a_region_is_no_part_of_a_goal() -> None:
    with pytest.raises(UnknownNameError, match="entity 'shared'"):
        Goal.from_pairs((("red_cube", "shared"),))


def test_a_goal_asks_for_something() -> None:
    with pytest.raises(InvalidConfigError, match="needs at least one predicate"):
        Goal(())


def test_a_spoilt_line_is_refused() -> None:
    cubes = tuple(
        ObjectPlacement("cube", color, Pose2(x, 0.0))
        for color, x in (("red", 0.0), ("blue", 0.3))
    )
    robots = (RobotPlacement("ur5", "red", Pose2(-1.0, 0.0)),)
    scene = SceneSpec(robots, cubes)
    goal = Goal.from_pairs((("red_cube", "blue_cube"),))
    data = Instance("stack", "free", 0, scene, goal, {}, ()).to_dict()
    data["objects"][0][1] = "purple"
    with pytest.raises(UnknownNameError, match="object color 'purple'"):
        Instance.from_dict(data)
    with pytest.raises(InvalidConfigError, match=r"length >= 1 - at `\$\.robots"):
        Instance.from_dict(data | {"robots": []})


@given(instances())
def test_files_of_ones_own_are_on_no_list(instance: Instance) -> None:
    assert Instance.read(instance.to_json()) == replace(instance, split=OWN_SPLIT)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("[1]", "describes no instance"),
        ("{}", "describes no instance"),
        ('{"version": "v1"}', "version"),
        (b"\xff\xfe\xff", "no JSON"),
    ],
)
def test_malformed_files_are_refused(text: str | bytes, says: str) -> None:
    with pytest.raises(InvalidConfigError, match=says):
        Instance.read(text)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidConfigError, match="cannot be read"):
        Instance.load(tmp_path)
