"""A stream is a pure function of its words."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from interpreter import told_without

from lemma.core.seeding import stream

words = st.lists(
    st.one_of(st.integers(0, 10_000), st.text("abc/_ ", max_size=6)), min_size=1
)


def draw(*key: str | int) -> list[float]:
    return stream(*key).random(4).tolist()


@given(words)
def test_same_words_same_stream(key: list[str | int]) -> None:
    assert draw(*key) == draw(*key)


@given(words, words)
def test_other_words_other_stream(a: list[str | int], b: list[str | int]) -> None:
    # Numbers are written as words: 3 and "3" are one word.
    if [str(word) for word in a] != [str(word) for word in b]:
        assert draw(*a) != draw(*b)


def test_where_one_word_ends_and_the_next_begins_matters() -> None:
    assert draw("ab", "c") != draw("a", "bc") != draw("abc")
    assert draw("a", "b") != draw("b", "a")
    assert draw("a") != draw("a", "")


def test_what_one_stream_draws_does_not_shift_another() -> None:
    alone = draw("v1", "stack", 3)
    other = stream("v1", "stack", 4)
    other.random(1000)
    first = stream("v1", "stack", 3)
    other.random(7)
    assert first.random(4).tolist() == alone


def test_no_global_state_is_read_or_written() -> None:
    np.random.seed(1)  # noqa: NPY002
    first = draw("v1", 0)
    after = np.random.random()  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    assert np.random.random() == after  # noqa: NPY002
    assert draw("v1", 0) == first


def test_the_numbers_are_those_of_every_other_machine_and_process() -> None:
    """Frozen: if these change, every instance of the benchmark does."""
    integers = stream("v1", "stack", "test", 3, "layout").integers(1_000_000, size=3)
    code = (
        "from lemma.core.seeding import stream; print(*stream('v1', 'stack', 'test', 3,"
        " 'layout').integers(1_000_000, size=3))"
    )
    elsewhere = told_without((), code)
    assert integers.tolist() == [int(word) for word in elsewhere.split()]
    assert integers.tolist() == [564616, 988485, 337325]
