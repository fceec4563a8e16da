"""Sentences as numbers: their words can be read off again, in their order."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lemma.tasks.language.bank import words
from lemma.tasks.language.template import KINDS
from lemma.tasks.language.vector import NUMBERS, WIDTH, WORDS, sentence_vector
from lemma.tasks.names import SUITE
from lemma.tasks.suite import load_instance


def said() -> list[str]:
    instances = [load_instance(task, "val", i) for task in SUITE for i in range(40)]
    return [one.instructions[kind] for one in instances for kind in KINDS]


def test_the_words_of_our_sentences_are_told_apart_and_find_room() -> None:
    known = {word for sentence in said() for word in words(sentence)}
    corners = {sentence_vector(word)[:WIDTH].tobytes() for word in known}
    assert len(known) > 100
    assert len(corners) == len(known)
    assert max(len(words(sentence)) for sentence in said()) <= WORDS


@given(st.lists(st.sampled_from(["red", "cube", "on", "the", "pad"]), max_size=50))
def test_order_counts_and_words_are_of_length_one(spoken: list[str]) -> None:
    vector = sentence_vector(" ".join(spoken))
    assert vector.shape == (NUMBERS,)
    assert vector.dtype == np.float32
    rows = vector.reshape(WORDS, WIDTH)
    there = min(len(spoken), WORDS)
    lengths = [1.0] * there + [0.0] * (WORDS - there)
    assert np.allclose(np.linalg.norm(rows, axis=1), lengths)
    for row, word in zip(rows, spoken, strict=False):
        assert np.array_equal(row, sentence_vector(word)[:WIDTH])


def test_case_and_punctuation_do_not_count() -> None:
    one = sentence_vector("Put the red cube on it.")
    assert np.array_equal(one, sentence_vector("put the RED cube on it"))
    assert not np.array_equal(one, sentence_vector("put the blue cube on it"))
