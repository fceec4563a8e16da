"""Controls of language: another goal, well-formed, on the same table where possible."""

import pytest

from lemma.evaluation.run.language_controls import FULL, LANGUAGES, OWN_SENTENCE, say
from lemma.scene.objects.entity import entity_named
from lemma.tasks.goal import Goal
from lemma.tasks.language.template import KINDS
from lemma.tasks.suite import SUITE, load_instance

INSTANCES = [(task, index) for task in SUITE for index in range(6)]


@pytest.mark.parametrize("kind", KINDS)
def test_swapped_colors_ask_for_another_goal(kind: str) -> None:
    there = 0
    for task, index in INSTANCES:
        instance = load_instance(task, "test", index)
        said = say("swapped", instance, kind)
        assert said.sentence is not None
        assert said.sentence != instance.instructions[kind]
        if said.asks is None:
            continue
        there += 1
        assert set(Goal.from_pairs(said.asks).entities) <= set(
            instance.scene.object_names
        )
        # No conjunct of the goal is asked for, so who obeys cannot reach it.
        assert not set(said.asks) & set(instance.goal.pairs)
        tops = [top for top, _ in said.asks]
        assert len(set(tops)) == len(tops)
    assert there > 0.8 * len(INSTANCES)


def test_the_words_stay_and_the_colors_change() -> None:
    instance = load_instance("stack", "test", 0)
    said = say("swapped", instance, "unseen")
    assert said.asks is not None
    colors = {entity_named(name).color for name in instance.scene.object_names[:5]}

    def bare(sentence: str) -> list[str]:
        return [w for w in sentence.lower().split() if w.strip(".,!?") not in colors]

    own = instance.instructions["unseen"]
    assert bare(said.sentence or "") == bare(own)


def test_every_kind_asks_for_the_same() -> None:
    instance = load_instance("pass2", "test", 3)
    asked = {say("swapped", instance, kind).asks for kind in KINDS}
    assert len(asked) == 1
    assert asked == {say("swapped", instance, "human").asks}


def test_where_there_is_nothing_else_colors_are_of_nothing() -> None:
    alone = next(
        instance
        for index in range(60)
        for instance in [load_instance("pass", "test", index)]
        if len(instance.scene.objects) == 2
    )
    said = say("swapped", alone, "high_level")
    assert said.asks is None
    assert said.sentence is not None
    cube, pad = alone.goal.pairs[0]
    assert f"{entity_named(cube).color} cube" not in said.sentence
    assert f"{entity_named(pad).color} pad" not in said.sentence


def test_shuffled_sentences_are_of_the_next_instance() -> None:
    last, first = load_instance("stack", "val", 39), load_instance("stack", "val", 0)
    said = say("shuffled", last, "human")
    assert said.sentence == first.instructions["human"]
    for index in range(40):
        instance = load_instance("stack", "val", index)
        asks = say("shuffled", instance, "human").asks
        if asks is not None:
            assert {name for pair in asks for name in pair} <= set(
                instance.scene.object_names
            )
            assert set(asks) != set(instance.goal.pairs)


def test_nothing_and_all() -> None:
    instance = load_instance("hook", "test", 0)
    assert say("none", instance, "human").sentence == ""
    assert say("full", instance, "human") == OWN_SENTENCE
    assert next(iter(LANGUAGES)) == FULL
