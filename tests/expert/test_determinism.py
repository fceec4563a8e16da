"""The same instance is the same episode: again, elsewhere, after others."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
from recorded_episodes import first_instance, recorded, run_expert
from tiers import slow_but

from lemma.env.episode import Episode
from lemma.tasks.suite import FREE_SPLIT, SUITE, load_instance

TEAM = "ur5+ur10"
FREE = [(task, 7) for task in SUITE if task != "poke_stack"]


def keyframes(task: str) -> list[str]:
    return run_expert(first_instance(task, TEAM))[3]


def free_hash(task: str, seed: int) -> str:
    return load_instance(task, FREE_SPLIT, seed).sha256()


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[ProcessPoolExecutor]:
    """Another process, which starts anew and knows nothing of this one."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        yield pool


@pytest.mark.parametrize("task", slow_but(SUITE, "stack", "poke"))
def test_run_again_after_others(task: str) -> None:
    first = recorded(task, TEAM)
    # Something else in between, in the same process.
    other = SUITE[(SUITE.index(task) + 3) % len(SUITE)]
    Episode(load_instance(other, "val", 1)).simulation.rest(0.5)
    assert keyframes(task) == list(first.hashes)
    assert len(set(first.hashes)) == len(first.steps) + 1


@pytest.mark.slow
def test_run_in_another_process(elsewhere: ProcessPoolExecutor) -> None:
    """In another order as well."""
    found = dict(zip(SUITE[::-1], elsewhere.map(keyframes, SUITE[::-1]), strict=True))
    for task in SUITE:
        assert found[task] == list(recorded(task, TEAM).hashes)


@pytest.mark.slow
def test_sampled_in_another_process(elsewhere: ProcessPoolExecutor) -> None:
    """Instance k is the same, whatever was sampled before it."""
    here = [free_hash(*key) for key in FREE]
    there = elsewhere.map(free_hash, *zip(*FREE[::-1], strict=True))
    assert list(there)[::-1] == here
    assert len(set(here)) == len(FREE)


@pytest.mark.slow
def test_two_episodes_at_once_do_not_disturb_each_other() -> None:
    """Step by step in turns, two simulations go as they go alone."""
    one, two = first_instance("stack", TEAM), first_instance("hook", TEAM)
    steps = [recorded(task, TEAM).steps for task in ("stack", "hook")]
    episodes = [Episode(one), Episode(two)]
    hashes: list[list[str]] = [[], []]
    for k in range(2):
        for which, episode in enumerate(episodes):
            episode.execute(steps[which][k].grounded)
            hashes[which].append(episode.simulation.scene.state_hash())
    assert hashes[0] == list(recorded("stack", TEAM).hashes[1:3])
    assert hashes[1] == list(recorded("hook", TEAM).hashes[1:3])
