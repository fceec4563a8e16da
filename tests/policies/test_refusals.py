"""Tests of sentences that are no order for the table."""

import re
import tomllib
from pathlib import Path

import pytest

from lemma.core.seeding import stream
from lemma.policies.text.encoder import resolved
from lemma.policies.text.refusals import (
    REASONS,
    RefusalBank,
    refusal_bank,
    unknown_things,
)

EVALUATION = Path(__file__).parent / "sentences" / "refusals.toml"


def words_of(line: str) -> set[str]:
    """Return the words of a line without its slots and rules."""
    return set(re.findall(r"[a-z']+", re.sub(r"\{\w+\}|<\w+>", " ", line.lower())))


def _ruled(bank: RefusalBank, line: str) -> list[str]:
    return [text for rule in re.findall(r"<(\w+)>", line) for text in bank.rules[rule]]


def test_every_reason_has_sentences_of_which_training_knows_other_words() -> None:
    parts = [refusal_bank(), refusal_bank(kept=True)]
    asked = RefusalBank.of(tomllib.loads(EVALUATION.read_text(encoding="utf-8")))
    assert not {*asked.colors, *asked.things} & {*parts[0].colors, *parts[0].things}
    assert all(set(bank.refused) == set(REASONS) for bank in (*parts, asked))
    assert sum(map(len, parts[0].refused.values())) >= 200
    assert sum(map(len, asked.refused.values())) >= 200
    for name, lines in (*asked.refused.items(), ("contrast", asked.orders["contrast"])):
        if name == "absent":
            # Its colors and things are what counts.
            continue
        taught = {
            word
            for bank in parts
            for line in (*bank.refused.get(name, ()), *bank.orders.get(name, ()))
            for text in (line, *_ruled(bank, line))
            for word in words_of(text)
        }
        said = [words_of(line) for line in lines]
        assert not [words for words in said if words and words <= taught]


def test_no_slot_or_choice_is_left() -> None:
    rng = stream("refusals", "test")
    said = {refusal_bank().draw(rng, plain=True)[0] for _ in range(2000)}
    assert len(said) > 1200
    assert not any(set(text) & set("{}<>|()") for text in said)


@pytest.mark.parametrize(
    ("text", "becomes"),
    [
        ("the red cube on the pad of its own color", "the red cube on the red pad"),
        ("Red block to the matching circle", "Red block to the red circle"),
        ("red cube, blue cube, the pad of its color", ""),
        ("put the red cube on the pad", ""),
    ],
)
def test_its_own_color_has_a_name(text: str, becomes: str) -> None:
    assert resolved(text) == (becomes or text)


def test_unknown_colors_are_named() -> None:
    assert unknown_things("Put the Purple cube on the red pad") == "purple cube"
    assert unknown_things("black on red") == "black thing"
    assert unknown_things("the red cube on the blue pad") == ""
