"""Words that unseen templates have and training paraphrases insert."""

from pathlib import Path

import pytest

import inserted_words as script
from lemma.tasks.language.bank import vocabulary

PAGE = Path(__file__).parents[2] / "docs" / "language.md"


def test_unseen_templates_have_words_of_their_own() -> None:
    found = script.unseen_words()
    assert {"beneath", "brick", "atop"} <= set(found)
    assert not set(found) & set(vocabulary())


def test_what_paraphrases_insert_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def say(*_: object) -> str:
        return "Put the zebra beneath the red cube, atop the table."

    monkeypatch.setattr(script, "paraphrase", say)
    assert script.inserted_words(2) == ("atop", "beneath")


def test_training_words_are_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script, "paraphrase", lambda *_: " ".join(vocabulary()))
    assert script.inserted_words(2) == ()


def test_the_page_lists_what_is_drawn() -> None:
    assert "```{inserted-words}" in PAGE.read_text("utf-8")
    assert set(script.inserted_words(40)) <= set(script.unseen_words())
