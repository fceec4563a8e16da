"""Controls of language: another goal, well-formed, on the same table where possible."""

import pytest

from lemma.evaluation.protocol.language_controls import (
    FULL,
    LANGUAGES,
    OWN_SENTENCE,
    control_of,
)
from lemma.scene.objects.entity import entity_named
from lemma.tasks.goal import Goal
from lemma.tasks.language.blind import instruction
from lemma.tasks.language.template import EVALUATION_KINDS
from lemma.tasks.suite import SUITE, load_instance

INSTANCES = [(task, index) for task in SUITE for index in range(6)]


@pytest.mark.parametrize("kind", EVALUATION_KINDS)
def test_swapped_colors_ask_for_another_goal(kind: str) -> None:
    there = 0
    for task, index in INSTANCES:
        instance = load_instance(task, "test", index)
        control = control_of("swapped", instance, kind)
        assert control.sentence is not None
        assert control.sentence != instruction(instance, kind)
        if control.asks is None:
            continue
        there += 1
        assert set(Goal.from_pairs(control.asks).entities) <= set(
            instance.scene.object_names
        )
        # No conjunct of the goal is asked for, so who obeys cannot reach it.
        assert not set(control.asks) & set(instance.goal.pairs)
        tops = [top for top, _ in control.asks]
        assert len(set(tops)) == len(tops)
    assert there > 0.8 * len(INSTANCES)


def test_the_words_stay_and_the_colors_change() -> None:
    instance = load_instance("stack", "test", 0)
    control = control_of("swapped", instance, "unseen")
    assert control.asks is not None
    colors = {entity_named(name).color for name in instance.scene.object_names[:5]}

    def bare(sentence: str) -> list[str]:
        return [w for w in sentence.lower().split() if w.strip(".,!?") not in colors]

    own = instance.instructions["unseen"]
    assert bare(control.sentence or "") == bare(own)


def test_every_kind_asks_for_the_same() -> None:
    instance = load_instance("pass2", "test", 3)
    asked = {control_of("swapped", instance, kind).asks for kind in EVALUATION_KINDS}
    assert len(asked) == 1
    assert asked == {control_of("swapped", instance, "human").asks}


def test_where_there_is_nothing_else_colors_are_of_nothing() -> None:
    alone = next(
        instance
        for index in range(60)
        for instance in [load_instance("pass", "test", index)]
        if len(instance.scene.objects) == 2
    )
    control = control_of("swapped", alone, "high_level")
    assert control.asks is None
    assert control.sentence is not None
    cube, pad = alone.goal.pairs[0]
    assert f"{entity_named(cube).color} cube" not in control.sentence
    assert f"{entity_named(pad).color} pad" not in control.sentence


def test_shuffled_sentences_are_of_the_next_instance() -> None:
    last, first = load_instance("stack", "val", 39), load_instance("stack", "val", 0)
    control = control_of("shuffled", last, "human")
    assert control.sentence == first.instructions["human"]
    for index in range(40):
        instance = load_instance("stack", "val", index)
        asks = control_of("shuffled", instance, "human").asks
        if asks is not None:
            assert {name for pair in asks for name in pair} <= set(
                instance.scene.object_names
            )
            assert set(asks) != set(instance.goal.pairs)


def test_nothing_and_all() -> None:
    instance = load_instance("hook", "test", 0)
    assert control_of("none", instance, "human").sentence == ""
    assert control_of("full", instance, "human") == OWN_SENTENCE
    assert next(iter(LANGUAGES)) == FULL
