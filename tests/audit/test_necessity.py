"""Every task needs both robots, every sub-task, and their order: tried in physics.

``lemma audit`` tries it on all frozen instances; here it is a few of them.
"""

import pytest

from lemma.audit.attack import ATTACKS
from lemma.audit.run import audit_instance
from lemma.env.episode import Episode
from lemma.expert.expert import Expert, solve
from lemma.tasks.suite import SUITE, load_instance

COUNT = 2
"""Instances of each task."""
QUICK = tuple(name for name in ATTACKS if ATTACKS[name].cheap)
STRUCTURE = tuple(name for name in ATTACKS if ATTACKS[name].team)


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_one_robot_alone_solves_none(task: str) -> None:
    for index in range(COUNT):
        instance = load_instance(task, "test", index)
        found = list(audit_instance(instance, QUICK))
        assert [one.attack for one in found if one.succeeded] == [], instance.key


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_out_of_order_or_with_one_skipped_none_is_solved(task: str) -> None:
    for index in range(COUNT):
        instance = load_instance(task, "test", index)
        found = list(audit_instance(instance, STRUCTURE))
        assert all(one.acted for one in found)
        assert [one.attack for one in found if one.succeeded] == [], instance.key


def test_nothing_left_out_and_in_order_it_does_succeed() -> None:
    """What the tests above do fails for the reason that they name."""
    for task in SUITE:
        episode = Episode(load_instance(task, "test", 0))
        expert = Expert(episode.simulation.scene, episode.instance.goal)
        assert all(step.result.ok for step in solve(episode, expert))
        assert episode.is_success
