"""Families with things of their own: fresh tables, ways to act, replays."""

from dataclasses import replace
from functools import cache

import pytest

from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.replay import replay
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.expert.together import solve_together
from lemma.tasks.instance import Instance
from lemma.tasks.sampling import sample
from lemma.tasks.suite import TASKS

JOINT = {"carry": "with your partner", "give": "to your partner"}
"""Families with a joint sub-task, and words of its instruction."""
FRESH = {"bridge": 30, "carry": 30, "give": 20, "unison": 30}
"""Number of fresh tables of each family."""

pytestmark = pytest.mark.slow


@cache
def instance(task: str, index: int) -> Instance:
    return sample(TASKS[task], "free", index).instance


def solved(task: str, index: int) -> tuple[Episode, int]:
    """Return an episode that the expert played, and its number of sub-tasks.

    Robots act in turns where that can be.
    """
    episode = Episode(instance(task, index))
    if not TASKS[task].in_turns:
        return episode, len(list(solve_together(episode)))
    expert = Expert(episode.simulation.scene, episode.instance.goal)
    return episode, len(list(solve(episode, expert)))


@pytest.mark.parametrize("task", FRESH)
def test_the_expert_solves_fresh_tables(task: str) -> None:
    count = 0
    for index in range(FRESH[task]):
        episode, steps = solved(task, index)
        count += episode.is_success and steps == TASKS[task].subtasks
        assert episode.is_success == (episode.progress == 1.0)
    assert count >= 0.95 * FRESH[task]


@pytest.mark.parametrize("task", JOINT)
def test_a_joint_sub_task_is_the_same_together_and_in_turns(task: str) -> None:
    together = Episode(instance(task, 0))
    assert all(step.result.ok for step in solve_together(together))
    turns, _ = solved(task, 0)
    assert together.is_success
    hashes = {e.simulation.scene.state_hash() for e in (together, turns)}
    assert len(hashes) == 1


@pytest.mark.parametrize("task", [*JOINT, "unison"])
def test_a_demonstration_replays_to_the_bit(task: str) -> None:
    record = record_episode(instance(task, 1))
    assert record.success
    assert JOINT.get(task, "") in record.subtasks[0].instruction
    assert replay(record).is_exact


def test_two_that_are_laid_down_together_are_recorded_as_they_begin() -> None:
    """Robots are at work at keyframes, and no keyframe is exact by chance."""
    record = record_episode(instance("unison", 1))
    begins = [step.start_s for step in record.subtasks]
    ends = [step.start_s + step.duration_s for step in record.subtasks]
    assert list(record.keyframe_time_s) == [*begins, record.elapsed_s]
    assert begins == sorted(begins)
    assert begins[2] < min(ends[1:])
    late = replace(record.subtasks[2], start_s=begins[2] + 0.01)
    other = replace(record, subtasks=(*record.subtasks[:2], late))
    assert replay(other).drift_at == 2
