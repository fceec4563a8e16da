"""Perturbed starts, and the table of the expert's times: frozen, and as they say."""

from dataclasses import replace

import pytest

from expert_times import is_alike, time_expert
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2, wrap
from lemma.evaluation.protocol.expert_times import (
    SHIFT_M,
    TIMED_SPLITS,
    TURN_RAD,
    expert_s,
    perturbed,
    perturbed_start,
)
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.suite import SUITE, load_instance


def moved(instance: Instance, name: str, dx: float) -> Instance:
    """Return an instance with one object shifted along x [m]."""
    objects = tuple(
        replace(o, pose=Pose2(o.pose.x + dx, o.pose.y, o.pose.yaw))
        if o.name == name
        else o
        for o in instance.scene.objects
    )
    return replace(instance, scene=replace(instance.scene, objects=objects))


@pytest.mark.parametrize("task", SUITE)
def test_everything_is_a_little_elsewhere(task: str) -> None:
    for index in range(5):
        instance = load_instance(task, "test", index)
        made = perturbed_start(instance)
        assert made == perturbed_start(instance)
        assert made.goal == instance.goal
        assert made.instructions == instance.instructions
        assert made.scene.robots == instance.scene.robots
        pairs = zip(made.scene.objects, instance.scene.objects, strict=True)
        for now, before in pairs:
            assert now.name == before.name
            assert 0.0 < now.pose.distance(before.pose) <= SHIFT_M + 1e-5
            assert abs(wrap(now.pose.yaw - before.pose.yaw)) <= TURN_RAD + 1e-5
        assert is_alike(made.scene, instance.scene)


def test_draws_differ() -> None:
    instance = load_instance("stack", "test", 0)
    assert perturbed(instance, 0) != perturbed(instance, 1)


def test_another_problem_is_not_alike() -> None:
    instance = load_instance("pass", "test", 1)
    cube = instance.goal.pairs[0][0]
    x = instance.scene.placement(cube).pose.x
    # To the other robot.
    assert not is_alike(moved(instance, cube, -2.0 * x).scene, instance.scene)
    assert not is_alike(moved(instance, cube, 5.0).scene, instance.scene)


def test_objects_do_not_touch() -> None:
    instance = load_instance("stack2", "test", 0)
    one, two, *rest = instance.scene.objects
    near = replace(one, pose=Pose2(two.pose.x + 0.06, two.pose.y, 0.0))
    scene = replace(instance.scene, objects=(near, two, *rest))
    assert not is_alike(scene, instance.scene)


def test_train_has_no_perturbed_starts() -> None:
    with pytest.raises(InvalidConfigError, match="train"):
        perturbed_start(load_instance("stack", "train", 0))
    assert expert_s("stack", "train", 0) is None


def test_the_table_is_whole() -> None:
    for split in TIMED_SPLITS:
        for task in SUITE:
            for index in range(SPLITS[split]):
                own = expert_s(task, split, index)
                other = expert_s(task, split, index, perturbed_start=True)
                assert own is not None
                assert other is not None
                assert 5.0 < own < 100.0
                assert abs(own - other) < 10.0


@pytest.mark.parametrize(
    ("task", "split", "index"), [("pass", "test", 7), ("stack2", "val", 4)]
)
def test_the_table_is_what_the_expert_takes(task: str, split: str, index: int) -> None:
    own, _, other = time_expert(task, split, index)
    assert own == expert_s(task, split, index)
    assert other == expert_s(task, split, index, perturbed_start=True), (
        "The expert's times are out of date: python scripts/expert_times.py"
    )
