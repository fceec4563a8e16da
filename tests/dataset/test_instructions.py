import json

import pytest
from command import run
from hypothesis import given, settings
from hypothesis import strategies as st
from recipes import made_up

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.dataset.instructions import (
    TRAINING_KINDS,
    Language,
    check_recorded,
    draw_instruction,
)
from lemma.tasks.instance import BENCHMARK_VERSION, SPLITS
from lemma.tasks.language.bank import templates
from lemma.tasks.suite import SUITE, load_instance

PAIRS = (("red_cube", "blue_cube"),)


def said(task: str, kind: str, sentence: str) -> bool:
    return any(template.parse(sentence) for template in templates(task, kind))


def said_by_anybody(kind: str, sentence: str) -> bool:
    return any(said(task, kind, sentence) for task in SUITE)


def test_both_kinds_and_all_their_templates_are_drawn() -> None:
    drawn = [draw_instruction("stack", PAIRS, "key", epoch=e) for e in range(600)]
    high = sum(said("stack", "high_level", sentence) for sentence in drawn)
    # Half of 600, give or take four standard deviations.
    assert abs(high - 300) < 49
    possible = {
        template.render(PAIRS)
        for kind in TRAINING_KINDS
        for template in templates("stack", kind)
    }
    assert set(drawn) == possible


@given(
    task=st.sampled_from(SUITE),
    index=st.integers(0, SPLITS["train"] - 1),
    seed=st.integers(0, 2**63),
    epoch=st.integers(0, 10**6),
    kinds=st.sampled_from([TRAINING_KINDS, ("high_level",), ("human",)]),
)
@settings(max_examples=300)
def test_whatever_is_drawn_is_for_training(
    task: str, index: int, seed: int, epoch: int, kinds: tuple[str, ...]
) -> None:
    instance = load_instance(task, "train", index)
    pairs = instance.goal.pairs
    sentence = draw_instruction(
        task, pairs, instance.key, seed=seed, epoch=epoch, kinds=kinds
    )
    assert not said_by_anybody("unseen", sentence)
    asked = [t.parse(sentence) for kind in kinds for t in templates(task, kind)]
    assert frozenset(pairs) in asked


@pytest.mark.parametrize("task", SUITE)
def test_the_check_knows_a_held_out_sentence(task: str) -> None:
    # Checks that the tests around this one can fail.
    pairs = load_instance(task, "train", 9).goal.pairs
    for template in templates(task, "unseen"):
        sentence = template.render(pairs)
        assert said_by_anybody("unseen", sentence)
        assert not said_by_anybody("high_level", sentence)
        assert not said_by_anybody("human", sentence)


def test_a_recipe_is_never_read_with_held_out_sentences_for_training() -> None:
    resampled = Language(instructions="resampled")
    for task in SUITE:
        record = made_up(task, "train", 5)
        for epoch in range(30):
            assert not said_by_anybody("unseen", resampled.choose(record, epoch))
        with pytest.raises(DatasetError, match="held out"):
            Language(kind="unseen").choose(record)
        assert Language(kind="unseen").choose(made_up(task, "test", 5)) == (
            made_up(task, "test", 5).unseen
        )


def test_resampling_says_more_than_was_recorded() -> None:
    record = made_up("hook", "train", 5)
    drawn = {Language(instructions="resampled").choose(record, e) for e in range(300)}
    # One high-level template and ten human ones.
    assert len(drawn) == 11
    assert {record.high_level, record.human} <= drawn
    # It follows the epoch and the seed, and nothing else.
    assert Language(instructions="resampled").choose(record, 3) == (
        Language(instructions="resampled").choose(record, 3)
    )
    other = Language(instructions="resampled", seed=1)
    assert any(
        other.choose(record, e) != Language(instructions="resampled").choose(record, e)
        for e in range(10)
    )


def test_kinds_can_be_chosen_but_not_the_held_out_ones() -> None:
    for epoch in range(20):
        drawn = draw_instruction("stack", PAIRS, "key", epoch=epoch, kinds=("human",))
        assert said("stack", "human", drawn)
    for kinds in (("unseen",), ("human", "unseen"), ()):
        with pytest.raises(InvalidConfigError, match="high_level, human"):
            draw_instruction("stack", PAIRS, "key", kinds=kinds)


def test_recorded_kinds_are_checked() -> None:
    check_recorded("human", ("train", "val"))
    check_recorded("unseen", ("val", "test"))
    with pytest.raises(DatasetError, match="held out"):
        check_recorded("unseen", ("test", "train"))
    with pytest.raises(UnknownNameError, match="Did you mean 'human'"):
        check_recorded("humans", ("val",))


def printed(capsys: pytest.CaptureFixture[str], *words: object) -> list[dict[str, str]]:
    assert run("instructions", *words, "--json") == 0
    records: list[dict[str, str]] = json.loads(capsys.readouterr().out)
    return records


@pytest.mark.parametrize("kind", ["high_level", "human", "unseen"])
def test_sentences_of_a_kind_are_printed(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    records = printed(capsys, "hook", "--n", 7, "--kind", kind)
    assert len(records) == 7
    for record in records:
        assert said("hook", kind, record["instruction"])
        index = int(record["instance"].rpartition("/")[2])
        goal = load_instance("hook", "train", index).goal.pairs
        asked = [t.parse(record["instruction"]) for t in templates("hook", kind)]
        assert frozenset(goal) in asked


def test_what_training_sees_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    records = printed(capsys, "stack")
    assert len(records) == 20
    sentences = [record["instruction"] for record in records]
    assert not any(said("stack", "unseen", sentence) for sentence in sentences)
    assert printed(capsys, "stack") == records
    assert printed(capsys, "stack", "--seed", 1) != records


def test_sub_instructions_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    records = printed(capsys, "hook", "--n", 5, "--kind", "sub")
    assert len(records) == 5
    assert len({record["instance"] for record in records[:4]}) == 1
    lines = [record["instruction"] for record in records]
    assert all(" robot: " in line for line in lines)
    assert "hook the" in lines[1]
    assert "shared space" in lines[2]


def test_instructions_as_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("instructions", "pass", "--n", 3) == 0
    assert capsys.readouterr().out.count(f"{BENCHMARK_VERSION}/pass/train/") == 3
