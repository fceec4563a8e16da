"""Rules of goals: plain data, said by one sentence alone, and kept by the planner."""

from itertools import pairwise

import numpy as np
import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.contacts import note_bad
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal, On
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import parse, robot_phrases, rule_templates
from lemma.tasks.language.template import KINDS, MAX_CHARACTERS
from lemma.tasks.suite import TASKS, load_instance
from lemma.tasks.teams.dependencies import predecessors
from lemma.tasks.teams.rule import (
    RULES,
    After,
    But,
    Rule,
    Together,
    Without,
    rule_from,
)

OF_EXCHANGE = TASKS["exchange"].rules
TESTS = [load_instance("exchange", "test", index) for index in range(60)]
PAIRS = (("red_cube", "red_pad"), ("blue_cube", "blue_pad"))


def of_kind(kind: str) -> list[Instance]:
    return [one for one in TESTS if one.goal.rule and one.goal.rule.kind == kind]


def possible(instance: Instance) -> list[Rule]:
    """Every rule that there might be on a table."""
    pairs = [
        (top, bottom)
        for top in instance.scene.object_names
        for bottom in instance.scene.object_names
        if top.endswith("cube") and bottom.endswith("pad")
    ]
    orders = [After(*a, *b) for a in pairs for b in pairs if a != b]
    robots = [Without(name) for name in instance.scene.robot_names]
    cubes = [n for n in instance.scene.object_names if n.endswith("cube")]
    return [*orders, *robots, *map(But, cubes)]


def test_a_rule_is_data_of_the_instance_and_others_have_none() -> None:
    for one in TESTS:
        assert one.goal.rule is not None
        assert Instance.from_dict(one.to_dict()) == one
        assert rule_from(one.to_dict()["rule"]) == one.goal.rule
    assert "rule" not in load_instance("tower", "test", 0).to_dict()
    assert {one.goal.rule.kind for one in TESTS if one.goal.rule} == {*OF_EXCHANGE}
    assert {kind for name in TASKS for kind in TASKS[name].rules} == {*RULES}


def test_a_rule_that_fits_nothing_is_refused() -> None:
    with pytest.raises(UnknownNameError):
        rule_from(["never", "red_cube"])
    for few in (["but"], ["together", "red_cube"]):
        with pytest.raises(InvalidConfigError):
            rule_from(few)
    with pytest.raises(InvalidConfigError):
        Goal.from_pairs(PAIRS, After("red_cube", "blue_pad", *PAIRS[1]))
    absent = {**TESTS[0].to_dict(), "rule": ["without", "robot_7"]}
    with pytest.raises(InvalidConfigError):
        Instance.from_dict(absent)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sentence_says_one_rule(kind: str) -> None:
    """No other rule of the table has a sentence that ends, or is, like it."""
    for one in TESTS[:6]:
        sentence, phrases = one.instructions[kind], robot_phrases(one.scene.robots)
        assert len(sentence) <= MAX_CHARACTERS
        assert parse(sentence) is None
        meant = {
            rule
            for rule in possible(one)
            for text in rule_templates(rule.kind, kind)
            if sentence.endswith(
                text.removeprefix("{goal} ").format(**rule.words(phrases))
            )
        }
        assert meant == {one.goal.rule}


@pytest.mark.parametrize("kind", OF_EXCHANGE)
def test_the_planner_keeps_the_rule_and_would_not_have_to(kind: str) -> None:
    free, tables = 0, of_kind(kind)[: 8 if kind == "after" else 3]
    for one in tables:
        now = SymbolicState.observe(Scene(one.scene))
        grounder = GeometricGrounder(one.scene)
        plan = find_plan(now, one.goal, grounder)
        assert plan is not None
        states = [now, *(step.after for step in plan.steps)]
        for subtask, (before, _) in zip(plan.subtasks, pairwise(states), strict=True):
            assert one.goal.permits(subtask, before.has)
        colors = {n.partition("_")[0] for n in one.scene.object_names if "pad" in n}
        every = [
            On(n, f"{n.removesuffix('_cube')}_pad")
            for n in one.scene.object_names
            if n.endswith("cube") and n.partition("_")[0] in colors
        ]
        read = Goal(tuple(every)) if kind == "but" else Goal(one.goal.conjuncts)
        blind = find_plan(now, read, grounder)
        assert blind is not None
        free += blind.subtasks != plan.subtasks
        regions = tuple(one.scene.regions)
        needs = predecessors(plan.subtasks, regions, one.goal.rule)
        more = needs != predecessors(plan.subtasks, regions)
        assert more == (kind == "after")
    # Of two orders, the planner takes one by chance where the rule does not ask.
    assert free >= (1 if kind == "after" else len(tables))


def test_nothing_but_the_sentence_tells_who_must_not_act() -> None:
    """The excluded robot and its fellow reach as much; either stands first."""
    first = 0
    found = of_kind("without")
    for one in found:
        assert one.goal.rule is not None
        grounder, named = GeometricGrounder(one.scene), one.goal.entities
        spots = [one.scene.placement(name).pose for name in named]
        reach = {
            robot: sum(grounder.reaches(robot, spot) for spot in spots)
            for robot in grounder.robots
        }
        alike = [robot for robot, count in reach.items() if count == 3]
        assert sorted(reach.values()) == [2, 3, 3]
        assert one.goal.rule.robot in alike
        first += alike.index(one.goal.rule.robot)
    assert 0.2 < first / len(found) < 0.8


@pytest.mark.parametrize("kind", KINDS)
def test_a_sentence_says_that_two_things_are_done_at_the_same_time(kind: str) -> None:
    """It names both cubes, and no other sentence of the same goal ends like it."""
    for index in range(6):
        one = load_instance("unison", "test", index)
        rule, sentence = one.goal.rule, one.instructions[kind]
        assert isinstance(rule, Together)
        assert rule.pairs == one.goal.pairs
        endings = [
            text.removeprefix("{goal} ").format(**rule.words(()))
            for text in rule_templates(rule.kind, kind)
        ]
        assert len([end for end in endings if sentence.endswith(end)]) == 1
        assert len(sentence) <= MAX_CHARACTERS
        assert parse(sentence) is None
        assert Instance.from_dict(one.to_dict()) == one


def test_the_first_forbidden_contact_is_found_as_by_numpy() -> None:
    draws = np.random.default_rng(3)
    found = []
    for _ in range(200):
        contacts = draws.integers(12, size=(draws.integers(6), 2), dtype=np.int32)
        who = draws.integers(5, size=12)
        bad = draws.random((5, 5)) < 0.1
        bad |= bad.T
        named = who[contacts]
        expected = np.flatnonzero(bad[named[:, 0], named[:, 1]])
        found.append(expected[0] if len(expected) else -1)
        first = np.full(2, -1)
        note_bad(contacts, who, bad, first)
        assert first.tolist() == ([-1, -1] if found[-1] < 0 else [*named[found[-1]]])
        # A later contact does not replace it.
        kept = first.copy()
        note_bad(np.zeros((1, 2), np.int32), who, np.ones((5, 5), np.bool_), first)
        assert found[-1] < 0 or first.tolist() == kept.tolist()
    assert {-1, 0, 1} <= {*found}
