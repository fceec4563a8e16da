"""Mistakes: each of its kind, and within its limits."""

import math
from collections import Counter
from dataclasses import replace

import pytest

from lemma.core.poses import Pose2, wrap
from lemma.core.seeding import stream
from lemma.expert.disturbances import (
    KINDS,
    PICK_OFF_M,
    PLACE_OFF_M,
    YAW_OFF_RAD,
    Mistake,
    Perturber,
)
from lemma.expert.expert import Expert
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.subtask import GroundedSubTask, SubTask
from lemma.tasks.suite import load_instance

Case = tuple[SubTask, GroundedSubTask, SymbolicState, list[Mistake]]


# In both some robot could do more than one other thing.
@pytest.fixture(scope="module", params=[("stack2", 0), ("hook", 10)], ids=str)
def case(request: pytest.FixtureRequest) -> Case:
    task, index = request.param
    instance = load_instance(task, "val", index)
    scene = Scene(instance.scene)
    subtask, grounded = Expert(scene, instance.goal).act()
    assert grounded is not None
    now = SymbolicState.observe(scene)
    saboteur = Perturber(instance.scene)
    mistakes = [
        saboteur.spoil(subtask, grounded, now, stream("mistake", i)) for i in range(120)
    ]
    return subtask, grounded, now, mistakes


def of_kind(case: Case, kind: str) -> list[Mistake]:
    return [mistake for mistake in case[3] if mistake.kind == kind]


def test_every_kind_happens(case: Case) -> None:
    counts = Counter(mistake.kind for mistake in case[3])
    assert set(counts) == set(KINDS)
    assert min(counts.values()) > 5


@pytest.mark.parametrize(
    ("kind", "limits_m"), [("pick", PICK_OFF_M), ("place", PLACE_OFF_M)]
)
def test_poses_are_off_within_limits(
    case: Case, kind: str, limits_m: tuple[float, float]
) -> None:
    subtask, grounded, _, _ = case
    for mistake in of_kind(case, kind):
        assert mistake.subtask == subtask
        exact: Pose2 = getattr(grounded, kind)
        off: Pose2 = getattr(mistake.grounded, kind)
        assert limits_m[0] <= exact.distance(off) <= limits_m[1]
        assert abs(wrap(off.yaw - exact.yaw)) <= YAW_OFF_RAD
        other = "place" if kind == "pick" else "pick"
        assert getattr(mistake.grounded, other) == getattr(grounded, other)


def test_what_is_dropped_ends_on_the_way(case: Case) -> None:
    _, grounded, _, _ = case
    pick, place = grounded.pick, grounded.place
    for mistake in of_kind(case, "drop"):
        end = mistake.grounded.place
        way = pick.distance(place)
        assert pick.distance(end) + end.distance(place) == pytest.approx(way)
        assert 0.2 * way <= pick.distance(end) <= 0.8 * way + 1e-9
        assert mistake.grounded.pick == pick


def test_another_robot_tries_the_same(case: Case) -> None:
    subtask, _, _, _ = case
    for mistake in of_kind(case, "robot"):
        assert mistake.subtask.robot == mistake.grounded.robot != subtask.robot
        assert replace(mistake.subtask, robot=subtask.robot) == subtask


def test_another_sub_task_could_be_done(case: Case) -> None:
    subtask, _, now, _ = case
    grounder = GeometricGrounder(now.spec)
    others = of_kind(case, "choice")
    assert len({mistake.subtask for mistake in others}) > 2
    for mistake in others:
        assert mistake.subtask != subtask
        step = grounder.ground(mistake.subtask, now)
        assert step is not None
        assert step.grounded == mistake.grounded


def test_the_stream_decides() -> None:
    instance = load_instance("poke", "val", 1)
    scene = Scene(instance.scene)
    subtask, grounded = Expert(scene, instance.goal).act()
    assert grounded is not None
    now = SymbolicState.observe(scene)
    one, again = (
        [
            Perturber(instance.scene).spoil(subtask, grounded, now, stream("a", i))
            for i in range(20)
        ]
        for _ in range(2)
    )
    assert one == again
    assert all(math.isfinite(m.grounded.place.yaw) for m in one)
