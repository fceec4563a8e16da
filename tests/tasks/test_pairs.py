"""Pairs: one table and sentence, one team that can and one that provably cannot."""

import hashlib
from collections import Counter

import pytest

from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.could import could_of
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene
from lemma.tasks.instance import Instance
from lemma.tasks.teams.pairs import TEST_PAIRS, Pair, sample_pair

DIGEST = "2f7eb0b3ca5362b19575f6230966ad050e5c3cf0f5524098d88b4da06fbf64de"


def has_plan(instance: Instance) -> bool:
    now = SymbolicState.observe(Scene(instance.scene))
    grounder = GeometricGrounder(instance.scene)
    return find_plan(now, instance.goal, grounder) is not None


def is_out(pair: Pair, name: str) -> bool:
    """Whether no robot could touch a thing, or put a cube on it, by arithmetic."""
    placed = pair.unable.scene.placement(name)
    size = kind_of(name).disc_m
    return all(
        robot.base.distance(placed.pose) - size
        > max(could_of(robot.arm).touch_m, could_of(robot.arm).place_m)
        for robot in pair.unable.scene.robots
    )


@pytest.mark.parametrize("index", range(6))
def test_only_the_arms_differ_and_decide(index: int) -> None:
    pair = sample_pair(index)
    able, unable = pair.able, pair.unable
    assert able.scene.objects == unable.scene.objects
    assert (able.goal, able.instructions) == (unable.goal, unable.instructions)
    for one, other in zip(able.scene.robots, unable.scene.robots, strict=True):
        assert (one.base, one.color) == (other.base, other.color)
    assert has_plan(able)
    assert not has_plan(unable)
    (thing,) = pair.lack.things
    assert is_out(pair, thing)
    said = pair.lack.words(("left robot", "right robot"))
    assert said == f"No robot reaches the {thing.replace('_', ' ')}."


@pytest.mark.slow
def test_the_test_pairs_are_always_the_same_and_arms_do_not_tell() -> None:
    pairs = [sample_pair(index) for index in range(TEST_PAIRS)]
    told = "".join(p.able.sha256() + p.unable.sha256() for p in pairs)
    assert hashlib.sha256(told.encode()).hexdigest() == DIGEST
    teams = Counter(
        (tuple(r.arm for r in one.scene.robots), can)
        for pair in pairs
        for one, can in ((pair.able, True), (pair.unable, False))
    )
    for arms in (("ur5", "ur10"), ("ur10", "ur5")):
        assert teams[arms, True] == teams[arms, False] == TEST_PAIRS // 3
    assert {len(pair.lack.things) for pair in pairs} == {1, 2}
    assert not any(has_plan(pair.unable) for pair in pairs)
