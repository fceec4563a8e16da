"""Tables that people change: what the sampler would not have done is named."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from lemma.core.poses import Pose2
from lemma.tasks.instance import Instance
from lemma.tasks.rules import problems
from lemma.tasks.suite import SUITE, load_instance


def moved(instance: Instance, name: str, pose: Pose2) -> Instance:
    objects = tuple(
        replace(placed, pose=pose) if placed.name == name else placed
        for placed in instance.scene.objects
    )
    return replace(instance, scene=replace(instance.scene, objects=objects))


def stood(instance: Instance, robot: int, base: Pose2) -> Instance:
    robots = list(instance.scene.robots)
    robots[robot] = replace(robots[robot], base=base)
    return replace(instance, scene=replace(instance.scene, robots=tuple(robots)))


@pytest.mark.parametrize("task", SUITE)
@pytest.mark.parametrize("split", ["train", "test"])
def test_what_was_sampled_is_right(task: str, split: str) -> None:
    for index in range(0, 60, 7):
        assert problems(load_instance(task, split, index)) == ()


STACK = load_instance("stack", "test", 0)
((TOP, BOTTOM),) = STACK.goal.pairs
HOOK = load_instance("hook", "test", 0)
POKE = load_instance("poke", "test", 0)


def beside(instance: Instance, name: str) -> Pose2:
    at = instance.scene.placement(name).pose
    return Pose2(at.x + 0.05, at.y)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda: moved(STACK, TOP, Pose2(0.0, 0.0)), "Now the"),
        (lambda: moved(STACK, TOP, Pose2(0.0, 1.9)), "completely on the table"),
        (lambda: moved(STACK, TOP, beside(STACK, BOTTOM)), "cm apart"),
        (lambda: moved(STACK, TOP, STACK.scene.robots[0].base), "base"),
        (lambda: moved(HOOK, "stick", Pose2(0.0, 0.0)), "All of the stick"),
        (lambda: moved(POKE, POKE.goal.entities[0], Pose2(0.0, 0.9)), "Now the"),
        (lambda: stood(STACK, 0, Pose2(-1.4, 0.0)), "m apart"),
        (lambda: stood(STACK, 0, replace(STACK.scene.robots[0].base, y=0.3)), "5 cm"),
        (lambda: stood(POKE, 0, replace(POKE.scene.robots[0].base, x=-1.2)), "apart"),
        (lambda: replace(POKE, scene=replace(POKE.scene, gap_m=None)), "gap"),
    ],
)
def test_what_was_changed_is_named(change: Callable[[], Instance], says: str) -> None:
    assert any(says in told for told in problems(change()))


def test_names_what_was_moved_and_nothing_else() -> None:
    (told,) = problems(moved(STACK, TOP, Pose2(0.0, 0.9)))
    assert TOP.replace("_", " ") in told
    assert BOTTOM.replace("_", " ") not in told
