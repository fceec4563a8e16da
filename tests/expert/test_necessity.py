"""Every task needs both robots, every sub-task, and their order."""

import pytest

from lemma.env.episode import Episode
from lemma.expert.grounding import GeometricGrounder
from lemma.expert.planner import find_plan
from lemma.expert.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import SUITE, load_instance

COUNT = 20
"""Instances of each task."""


def looked_at(
    task: str, index: int
) -> tuple[Instance, SymbolicState, GeometricGrounder]:
    instance = load_instance(task, "test", index)
    return (
        instance,
        SymbolicState.observe(Scene(instance.scene)),
        GeometricGrounder(instance.scene),
    )


def plan_of(task: str, index: int) -> tuple[Instance, tuple[SubTask, ...]]:
    instance, now, grounder = looked_at(task, index)
    plan = find_plan(now, instance.goal, grounder)
    assert plan is not None
    return instance, plan.subtasks


def attempt(instance: Instance, subtasks: tuple[SubTask, ...]) -> Episode:
    """Execute sub-tasks in this order; what cannot be grounded is left out."""
    episode = Episode(instance)
    grounder = GeometricGrounder(instance.scene)
    for subtask in subtasks:
        now = SymbolicState.observe(episode.simulation.scene)
        step = grounder.ground(subtask, now)
        if step is not None and not episode.is_over:
            episode.execute(step.grounded)
    episode.simulation.rest(0.1)
    return episode


@pytest.mark.parametrize("task", SUITE)
def test_one_robot_alone_finds_no_plan(task: str) -> None:
    for index in range(COUNT):
        instance, now, grounder = looked_at(task, index)
        assert find_plan(now, instance.goal, grounder) is not None
        for robot in grounder.robots:
            alone = find_plan(
                now, instance.goal, grounder, limit_s=1000.0, team=(robot,)
            )
            assert alone is None, f"{robot} alone solves {instance.key}"


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_in_reversed_order_it_does_not_succeed(task: str) -> None:
    for index in range(COUNT):
        instance, subtasks = plan_of(task, index)
        episode = attempt(instance, subtasks[::-1])
        assert not episode.is_success, f"{instance.key} is solved backwards"


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_with_one_sub_task_skipped_it_does_not_succeed(task: str) -> None:
    """Another one in every instance, so that each is left out at times."""
    for index in range(COUNT):
        instance, subtasks = plan_of(task, index)
        skip = index % len(subtasks)
        episode = attempt(instance, subtasks[:skip] + subtasks[skip + 1 :])
        assert not episode.is_success, f"{instance.key} without {subtasks[skip]}"


def test_nothing_left_out_and_in_order_it_does_succeed() -> None:
    """What the tests above do fails for the reason that they name."""
    for task in SUITE:
        instance, subtasks = plan_of(task, 0)
        assert attempt(instance, subtasks).is_success
