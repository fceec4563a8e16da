import json

import pytest

from lemma.cli.main import main
from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.dataset.instructions import (
    TRAINING_KINDS,
    check_recorded,
    draw_instruction,
)
from lemma.tasks.language import templates
from lemma.tasks.suite import SUITE, load_instance

PAIRS = (("red_cube", "blue_cube"),)


def said(task: str, kind: str, sentence: str) -> bool:
    return any(template.parse(sentence) for template in templates(task, kind))


def test_drawing_is_a_pure_function() -> None:
    first = draw_instruction("stack", PAIRS, "v1/stack/train/3", seed=1, epoch=2)
    draw_instruction("stack", PAIRS, "v1/stack/train/4", seed=1, epoch=2)
    again = draw_instruction("stack", PAIRS, "v1/stack/train/3", seed=1, epoch=2)
    assert first == again


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


@pytest.mark.parametrize("task", SUITE)
def test_nothing_held_out_is_drawn(task: str) -> None:
    instance = load_instance(task, "train", 0)
    for epoch in range(40):
        sentence = draw_instruction(
            task, instance.goal.pairs, instance.key, epoch=epoch
        )
        assert not said(task, "unseen", sentence)
        assert any(said(task, kind, sentence) for kind in TRAINING_KINDS)


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


def run(*words: object) -> int | str | None:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return end.value.code


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
    assert capsys.readouterr().out.count("v1/pass/train/") == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("stak",), "Did you mean 'stack'?"),
        (("stack", "--n", "0"), "from 1 up"),
        (("stack", "--seed", "-1"), "from 0"),
    ],
)
def test_bad_input_is_explained(
    words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("instructions", *words) == 2
    assert message in capsys.readouterr().err
