"""Tests of sentences that are no order for the table."""

import tomllib
from pathlib import Path

import pytest

from lemma.core.seeding import stream
from lemma.policies.text.refusals import (
    REASONS,
    RefusalBank,
    refusal_bank,
    resolved,
    unknown_things,
)

EVALUATION = Path(__file__).parent / "sentences" / "refusals.toml"


def test_every_reason_has_sentences_and_no_line_of_evaluation_is_taught() -> None:
    taught, kept = refusal_bank(), refusal_bank(kept=True)
    source = tomllib.loads(EVALUATION.read_text(encoding="utf-8"))
    asked = RefusalBank.of(source)
    for bank in (taught, kept, asked):
        assert set(bank.refused) == set(REASONS)
    lines = {
        line for bank in (taught, kept) for of in bank.refused.values() for line in of
    }
    held = {line for of in asked.refused.values() for line in of}
    assert len(lines) >= 200
    assert len(held) >= 200
    assert not lines & held
    rng = stream("refusals", "test")
    said = {taught.draw(rng, plain=True)[0] for _ in range(2000)}
    # Thousands of sentences, in which no slot or choice is left.
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
