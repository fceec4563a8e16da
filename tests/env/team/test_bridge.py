"""Family bridge: a plank lies on two posts, and on nothing else."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.core.poses import Pose, Pose2
from lemma.env.action_spaces import encode_plan, picks, places
from lemma.motion.outcome import Outcome, SkillResult
from lemma.planning.grounding import (
    GeometricGrounder,
    GroundedOption,
    ground_or_refuse,
)
from lemma.planning.pddl import to_pddl
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.pad import PAD_THICKNESS_M
from lemma.scene.objects.plank import (
    PLANK_LENGTH_M,
    PLANK_SPAN_M,
    PLANK_THICKNESS_M,
)
from lemma.scene.scene import Scene
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal, On
from lemma.tasks.language.template import Template
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.coalitions import needed
from lemma.tasks.teams.dependencies import predecessors
from lemma.tasks.zones import Territory

PRESS = 1e-5
"""Depth of an object in its support [m]: contacts are soft."""
HALF = PLANK_SPAN_M / 2
TOP = PAD_THICKNESS_M + CUBE_EDGE_M
"""Height of the top of a post [m]."""
AT = Pose2(0.1, -0.2, 0.7)
"""Middle of the bridge."""
SPEC = SceneSpec(
    (
        RobotPlacement("ur5", "red", Pose2(-0.6, 0.0, 0.0)),
        RobotPlacement("ur5", "white", Pose2(0.9, 0.0, math.pi)),
    ),
    (
        ObjectPlacement("cube", "red", Pose2(0.1, 0.3)),
        ObjectPlacement("cube", "blue", Pose2(-0.1, 0.3)),
        ObjectPlacement("cube", "green", Pose2(-0.1, 0.5)),
        ObjectPlacement("pad", "red", AT @ Pose2(-HALF, 0.0)),
        ObjectPlacement("pad", "blue", AT @ Pose2(HALF, 0.0)),
        ObjectPlacement("plank", "plank", Pose2(0.1, 0.5)),
    ),
)
POSTS = ("red_cube", "blue_cube")
GOAL = Goal(
    (
        *(On(post, post.replace("cube", "pad")) for post in POSTS),
        *(On("plank", post) for post in POSTS),
    )
)


@pytest.fixture
def scene() -> Scene:
    """Both posts on their pads, the plank on the table."""
    found = Scene(SPEC)
    for post, side in zip(POSTS, (-HALF, HALF), strict=True):
        put(found, post, AT @ Pose2(side, 0.0, 0.3), PAD_THICKNESS_M)
    return found


def put(scene: Scene, name: str, at: Pose2, bottom_m: float, dive: float = 0.0) -> None:
    """Put an object on something, its x axis turned and then down by an angle."""
    half_m = (PLANK_THICKNESS_M if name == "plank" else CUBE_EDGE_M) / 2
    (a, b), (c, d) = ((math.cos(w / 2), math.sin(w / 2)) for w in (at.yaw, dive))
    quaternion = (a * c, -b * d, a * d, b * c)
    # A post stands a little lower than its height.
    press_m = 2.0 * PRESS if name == "plank" else PRESS
    height = bottom_m + half_m * math.cos(dive) - press_m
    scene.set_pose(name, Pose((at.x, at.y, height), quaternion))


def held(scene: Scene) -> list[bool]:
    return [on.holds(scene) for on in GOAL.conjuncts]


# --- The goal ----------------------------------------------------------------------


@pytest.mark.parametrize("along", [-0.01, 0.0, 0.01])
@pytest.mark.parametrize("turn", [0.0, math.pi])
def test_a_plank_on_both_posts(scene: Scene, along: float, turn: float) -> None:
    put(scene, "plank", AT @ Pose2(along, 0.005, turn), TOP)
    assert held(scene) == [True] * 4
    now = SymbolicState.observe(scene)
    assert (now.supports["plank"], now.seconds["plank"]) == ("blue_cube", "red_cube")
    assert all(now.has("plank", post) for post in POSTS)
    assert all(now.on_top_of(post) == "plank" for post in POSTS)


def test_a_plank_on_one_post_alone_does_not_count(scene: Scene) -> None:
    """In its middle, where it might be balanced, or by one end."""
    for along in (-HALF, HALF, 2.0 * HALF):
        put(scene, "plank", AT @ Pose2(along, 0.0), TOP)
        assert held(scene) == [True, True, False, False]
        assert not SymbolicState.observe(scene).seconds


def test_a_plank_that_leans_from_the_table_on_a_post_does_not_count(
    scene: Scene,
) -> None:
    """Let go there, physics decides how it comes to rest: never on both posts."""
    for _ in range(2):
        dive = math.asin(0.8 * TOP / PLANK_LENGTH_M)
        put(scene, "plank", AT @ Pose2(-HALF - 0.10, 0.0, math.pi), 0.5 * TOP, dive)
        assert not any(held(scene)[2:])
        mujoco.mj_step(scene.model, scene.data, 400)
        assert not all(held(scene)[2:])
        assert not SymbolicState.observe(scene).seconds
        put(scene, "plank", AT @ Pose2(HALF + 0.10, 0.0), 0.5 * TOP, dive)


def test_one_post_and_another_thing_make_half_of_a_bridge(scene: Scene) -> None:
    put(scene, "blue_cube", Pose2(-0.1, 0.3), 0.0)
    put(scene, "green_cube", AT @ Pose2(HALF, 0.0), PAD_THICKNESS_M)
    put(scene, "plank", AT, TOP)
    assert held(scene) == [True, False, True, False]


def test_a_plank_over_posts_that_it_does_not_touch(scene: Scene) -> None:
    put(scene, "plank", AT, TOP + 0.002)
    assert held(scene) == [True, True, False, False]
    put(scene, "plank", AT @ Pose2(0.0, 0.03), TOP)
    assert held(scene) == [True, True, False, False]


def test_a_bridge_on_the_table_is_no_bridge_on_the_pads(scene: Scene) -> None:
    for post, side in zip(POSTS, (-HALF, HALF), strict=True):
        put(scene, post, Pose2(-0.1, -0.5) @ Pose2(side, 0.0), 0.0)
    put(scene, "plank", Pose2(-0.1, -0.5), CUBE_EDGE_M)
    assert held(scene) == [False, False, True, True]


# --- Planning ----------------------------------------------------------------------


LAY = SubTask("robot_0", Primitive.MOVE, "plank", "red_cube")


def test_a_plank_needs_two_free_posts_at_its_span(scene: Scene) -> None:
    put(scene, "plank", Pose2(-0.2, -0.4), 0.0)
    now, grounder = SymbolicState.observe(scene), GeometricGrounder(SPEC)
    option = ground_or_refuse(LAY, now, grounder)
    assert isinstance(option, GroundedOption)
    place = option.grounded.place
    assert place.distance(AT) < 1e-9
    assert math.sin(place.yaw - AT.yaw) == pytest.approx(0.0, abs=1e-9)
    assert all(option.after.has("plank", post) for post in POSTS)
    same = grounder.ground(replace(LAY, place="blue_cube"), now)
    assert same is not None
    assert same.after.key == option.after.key

    away = now.moved("blue_cube", Pose2(0.4, 0.2), TABLE, "shared")
    refused = ground_or_refuse(LAY, away, grounder)
    assert isinstance(refused, SkillResult)
    assert refused.outcome is Outcome.INVALID
    low = now.moved("blue_cube", now.poses["blue_cube"], TABLE, "start")
    assert grounder.ground(LAY, low) is None
    topped = now.moved("green_cube", now.poses["blue_cube"], "blue_cube", "on")
    assert grounder.ground(LAY, topped) is None


def test_what_carries_a_plank_stays(scene: Scene) -> None:
    put(scene, "plank", AT, TOP)
    now, grounder = SymbolicState.observe(scene), GeometricGrounder(SPEC)
    for post in POSTS:
        taken = ground_or_refuse(replace(LAY, pick=post, place="shared"), now, grounder)
        assert isinstance(taken, SkillResult)
        assert taken.explanation == f"The plank lies on the {post}."
    again = ground_or_refuse(LAY, now, grounder)
    assert isinstance(again, SkillResult)
    assert again.explanation == "The plank lies there already."


def test_a_plank_waits_for_every_post() -> None:
    move = SubTask("robot_0", Primitive.MOVE, "red_cube", "red_pad")
    steps = (move, replace(move, pick="blue_cube", place="blue_pad"), LAY)
    assert predecessors(steps, ("shared",))[2] == {0: "place", 1: "place"}
    aside = replace(LAY, place="shared")
    assert predecessors((*steps[:2], aside), ("shared",))[2] == {}


def test_a_bridge_cannot_be_told_in_pddl() -> None:
    instance = load_instance("bridge", "val", 0)
    now = SymbolicState.observe(Scene(instance.scene))
    with pytest.raises(InvalidConfigError, match="a plank"):
        to_pddl("bridge", now, instance.goal, GeometricGrounder(instance.scene))


# --- Robots that are needed -------------------------------------------------------


def test_a_plank_in_the_hand_reaches_farther() -> None:
    """A cube is out of reach of a hand, and of a plank only where there is none."""
    robots = tuple(
        RobotPlacement("ur5", color, Pose2(x, 0.0))
        for color, x in (("red", -1.5), ("white", 0.0))
    )
    cube = ObjectPlacement("cube", "red", Pose2(-1.3, 0.0))
    pad = ObjectPlacement("pad", "red", Pose2(-0.75, 0.0))
    plank = ObjectPlacement("plank", "plank", Pose2(0.6, 0.0))
    goal, territory = Goal((On("red_cube", "red_pad"),)), Territory(robots)
    assert 0 in needed(territory, (cube, pad), goal)
    assert 0 not in needed(territory, (cube, pad, plank), goal)


# --- Numbers of actions and observations -------------------------------------------


def test_only_its_task_counts_the_plank() -> None:
    assert "plank" not in (*picks(), *places(3))
    assert picks(("plank",)) == (*picks(), "plank")
    assert places(3, ("plank",)) == (*places(3), "plank")
    with pytest.raises(InvalidActionError, match="No table ever has"):
        encode_plan(LAY, 3)
    instance = load_instance("bridge", "val", 0)
    env = lemma.make("bridge", level="plan", observation="privileged", split="val")
    seen, _ = env.reset(options={"instance": instance})
    assert seen["present"][-1] == 1
    assert np.flatnonzero(seen["goal"][-1]).size == 2
    action = env.encode(LAY)
    assert env.action_space.contains(action)
    assert env.decode(action) == LAY
    other = lemma.make("sort", level="plan", split="val")
    with pytest.raises(InvalidConfigError, match="Make the environment of bridge"):
        other.reset(options={"instance": instance})


# --- Sentences ---------------------------------------------------------------------


KINDS = [["cube", "pad"], ["plank", "top1"]]


def test_a_sentence_need_not_say_twice_what_is_meant() -> None:
    template = Template.from_string("{top1} on {bottom1}, plank on top", KINDS)
    pairs = (("red_cube", "blue_pad"), ("plank", "red_cube"))
    said = template.render(pairs)
    assert said == "red cube on blue pad, plank on top"
    assert template.parse(said) == frozenset(pairs)
    with pytest.raises(InvalidConfigError, match="the goal has 'blue_cube'"):
        template.render((pairs[0], ("plank", "blue_cube")))
    with pytest.raises(InvalidConfigError, match="earlier pair"):
        Template.from_string("{top1} on {bottom1}", [KINDS[0], ["plank", "top2"]])
