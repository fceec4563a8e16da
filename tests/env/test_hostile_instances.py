"""Instances from outside: JSON of any form, and tables that cannot be set."""

import copy
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lemma
from lemma.core.errors import InvalidConfigError, LemmaError, PhysicsError
from lemma.core.poses import Pose2
from lemma.env.base_env import LemmaEnv
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance

GOOD = lemma.load_instance("stack", "test", 0)
DATA = GOOD.to_dict()
ABSENT = next(
    cube
    for cube in (f"{color}_cube" for color in BENCHMARK_COLORS)
    if cube not in GOOD.scene.object_names
)
NUMBERS: tuple[Any, ...] = (
    math.nan,
    math.inf,
    -math.inf,
    1e300,
    10**400,
    12.0,
    "0",
    None,
    True,
    [],
    {},
)


def with_part(path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """Return the data of a good instance with one part changed."""
    data = copy.deepcopy(DATA)
    at: Any = data
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = value
    return data


def bad_data() -> list[Any]:
    deep: Any = []
    for _ in range(5000):
        deep = [deep]
    found: list[Any] = [None, 5, "x", [], {}, {"task": "stack"}, deep]
    found += [{k: v for k, v in DATA.items() if k != key} for key in DATA]
    found += [with_part((key,), value) for key in DATA for value in (None, -5, deep)]
    found += [
        with_part((key, 0, number), value)
        for key in ("robots", "objects")
        for number in (2, 3)
        for value in NUMBERS
    ]
    found += [
        with_part(("index",), -1),
        with_part(("index",), 1.5),
        with_part(("robots", 0, 0), "ur7"),
        with_part(("robots", 0, 0), ["ur5"]),
        with_part(("robots", 0, 1), "purple"),
        with_part(("robots", 0), ["ur5"]),
        with_part(("objects", 0, 0), "sphere"),
        with_part(("objects", 0, 1), "no color"),
        with_part(("objects", 1), DATA["objects"][0]),
        with_part(("objects",), []),
        with_part(("goal",), []),
        with_part(("goal",), [["stick", "stick"]]),
        with_part(("goal",), [["red_cube"]]),
        with_part(("instructions",), {"human": 5}),
        with_part(("distractors",), ["moon"]),
    ]
    # Optional keys, or keys that do not describe the problem.
    return [one for one in found if not (isinstance(one, dict) and tolerated(one))]


def tolerated(data: dict[str, Any]) -> bool:
    rest = {key: value for key, value in data.items() if key != "version"}
    return rest == {key: value for key, value in DATA.items() if key != "version"}


def test_data_of_any_form_are_refused() -> None:
    cases = bad_data()
    assert len(cases) > 80
    for data in cases:
        with pytest.raises(LemmaError) as caught:
            Instance.from_dict(data)
        assert len(str(caught.value)) < 600


def test_what_was_wrong_is_named() -> None:
    with pytest.raises(InvalidConfigError, match=r"`\$.robots\[0\]\[2\]`"):
        Instance.from_dict(with_part(("robots", 0, 2), "0"))
    with pytest.raises(InvalidConfigError, match=r"missing.*`goal`"):
        Instance.from_dict({k: v for k, v in DATA.items() if k != "goal"})
    with pytest.raises(InvalidConfigError, match=r"x in the base of the .*=nan"):
        Instance.from_dict(with_part(("robots", 0, 2), math.nan))


def moved(index: int, pose: Pose2) -> Instance:
    placed = list(GOOD.scene.objects)
    placed[index] = replace(placed[index], pose=pose)
    return replace(GOOD, scene=replace(GOOD.scene, objects=tuple(placed)))


def based(pose: Pose2) -> Instance:
    robots = (GOOD.scene.robots[0], replace(GOOD.scene.robots[1], base=pose))
    return replace(GOOD, scene=replace(GOOD.scene, robots=robots))


def assert_usable(env: LemmaEnv) -> None:
    assert env.reset(options={"instance": GOOD})[1]["instance"] == GOOD.key
    env.step(env.action_space.sample())


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda: moved(0, GOOD.scene.objects[1].pose), "overlap by"),
        (
            lambda: moved(0, GOOD.scene.robots[0].base),
            r"robot_0 and .* overlap|and robot_0 overlap",
        ),
        (lambda: moved(0, Pose2(1.72, 0.0)), "not lie on the table"),
        (lambda: moved(0, Pose2(0.0, -4.9)), "not lie on the table"),
        (lambda: based(GOOD.scene.robots[0].base), "robot_0 and robot_1 overlap"),
        (lambda: replace(GOOD, instructions={}), "no instruction of the kind"),
        (
            lambda: replace(GOOD, instructions={"high_level": "x" * 300}),
            "cannot be observed",
        ),
        (
            lambda: replace(
                GOOD, scene=replace(GOOD.scene, robots=GOOD.scene.robots[:1])
            ),
            "has the team",
        ),
    ],
)
def test_table_that_cannot_be_set_is_refused(
    broken: Callable[[], Instance], words: str
) -> None:
    env = lemma.make("stack", split="test", index=0)
    env.reset()
    before = env.state_hash()
    with pytest.raises(InvalidConfigError, match=words):
        env.reset(options={"instance": broken()})
    assert env.state_hash() == before
    assert_usable(env)


@pytest.mark.parametrize(
    "make",
    [
        lambda: RobotPlacement("ur5", "red", None),  # type: ignore[arg-type]
        lambda: RobotPlacement("ur5", ["red"], Pose2(0, 0)),  # type: ignore[arg-type]
        lambda: RobotPlacement("ur5", "red", Pose2(math.nan, 0.0)),
        lambda: RobotPlacement("ur5", "red", Pose2(0.0, 0.0, math.inf)),
        lambda: ObjectPlacement("cube", "red", Pose2(1e6, 0.0)),
        lambda: ObjectPlacement("cube", "red", (0.0, 0.0)),  # type: ignore[arg-type]
        lambda: SceneSpec([], ()),  # type: ignore[arg-type]
        lambda: SceneSpec((5,), ()),  # type: ignore[arg-type]
        lambda: replace(GOOD, scene=None),  # type: ignore[arg-type]
        lambda: replace(GOOD, goal=Goal.from_pairs(((ABSENT, "red_pad"),))),
        lambda: replace(GOOD, distractors=("moon",)),
        lambda: replace(GOOD, index=-1),
    ],
)
def test_parts_that_do_not_fit_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(LemmaError):
        make()


def test_cube_does_not_begin_on_a_pad() -> None:
    # A pad is a plate: what is placed on the table there would be inside it.
    cube = next(o for o in GOOD.scene.objects if o.kind == "cube")
    taken = {o.color for o in GOOD.scene.objects if o.kind == "pad"}
    color = next(c for c in ("pink", "red", "white", "blue", "green") if c not in taken)
    pad = ObjectPlacement("pad", color, cube.pose)
    scene = replace(GOOD.scene, objects=(*GOOD.scene.objects, pad))
    with pytest.raises(InvalidConfigError, match="overlap by"):
        lemma.Episode(replace(GOOD, scene=scene))


def test_physics_that_diverge_end_with_an_error() -> None:
    # Until 0.1.0 time began anew again and again, and a skill never ended.
    env = lemma.make("stack", level="plan", split="test", index=0)
    expert = lemma.ExpertPolicy(env)
    env.reset()
    action = expert.act()
    env.episode.simulation.tick()
    env.episode.simulation.scene.data.qvel[:] = math.nan
    with pytest.raises(PhysicsError, match="unstable"):
        env.step(action)
    assert_usable(env)


near = st.floats(-2.0, 2.0)
anything = st.one_of(
    st.floats(), st.integers(), st.text(max_size=5), st.none(), st.booleans()
)


@settings(
    max_examples=30,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(
    st.lists(st.tuples(near, near, near), min_size=1, max_size=4),
    st.tuples(near, near, near),
)
def test_any_table_is_set_or_refused(
    poses: list[tuple[float, float, float]], base: tuple[float, float, float]
) -> None:
    data = copy.deepcopy(DATA)
    for placed, pose in zip(data["objects"], poses, strict=False):
        placed[2:] = pose
    data["robots"][1][2:] = base
    env = lemma.make("stack", split="test", index=0)
    start = time.perf_counter()
    try:
        env.reset(options={"instance": Instance.from_dict(data)})
        env.action_space.seed(0)
        for _ in range(3):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                break
        state = env.info()["state"]
        assert all(math.isfinite(x) for pose in state.values() for x in pose)
    except InvalidConfigError:
        pass
    assert time.perf_counter() - start < 30.0


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(list(DATA)),
    st.recursive(
        anything,
        lambda inner: st.one_of(
            st.lists(inner, max_size=5),
            st.dictionaries(st.text(max_size=5), inner, max_size=3),
        ),
        max_leaves=20,
    ),
)
def test_any_json_is_an_instance_or_refused(key: str, value: Any) -> None:
    try:
        found = Instance.from_dict({**copy.deepcopy(DATA), key: value})
    except LemmaError:
        return
    assert Instance.from_dict(found.to_dict()) == found
