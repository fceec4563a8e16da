from typing import get_args

import numpy as np
import pytest
import torch
from tiers import slow_but

from lemma.core.seeding import stream
from lemma.policies.entities import BENCHMARK
from lemma.policies.text import paraphrase as paraphrases
from lemma.policies.text.encoder import (
    SentenceReader,
    TextConfig,
    TextEncoder,
    TextKind,
)
from lemma.policies.text.grammar import grammar
from lemma.policies.text.paraphrase import CHANCES, paraphrase
from lemma.policies.text.rules import say_rule_anew, wordings
from lemma.policies.text.words import (
    UNKNOWN,
    Vocabulary,
    edit_distance,
    neighbours,
    word_vectors,
)
from lemma.tasks.language.bank import rule_templates, templates, vocabulary, words
from lemma.tasks.suite import SUITE, load_instance
from lemma.tasks.teams.rule import RULES, After, But, Rule, Together, Without

SENTENCE = "Place the red cube on top of the blue pad"
OTHER = "Place the white cube on top of the red pad"
GOAL = (("red_cube", "blue_pad"),)
TWO_GOALS = (("red_cube", "blue_pad"), ("white_cube", "red_pad"))


def encoder(kind: str = "words", **options: float) -> TextEncoder:
    torch.manual_seed(0)
    return TextEncoder(TextConfig(kind=kind, width=32, **options)).eval()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [("red", "red", 0), ("teh", "the", 1), ("whit", "white", 1), ("", "pad", 3)],
)
def test_edit_distance(a: str, b: str, distance: int) -> None:
    assert edit_distance(a, b) == edit_distance(b, a) == distance


def test_typing_errors_are_put_right_and_real_words_are_left_alone() -> None:
    known = Vocabulary(word_vectors().words)
    assert known.read("PLASE teh wite cubbe on teh pnik pad!") == (
        *("place", "the", "white", "cube"),
        *("on", "the", "pink", "pad"),
    )
    for word in ("rid", "cuba", "sock", "pant"):
        assert known.read(word) == (word,)
        assert known.number(word) == UNKNOWN


def test_the_nearest_of_all_words_is_found() -> None:
    known, rng = Vocabulary(word_vectors().words), stream("typing errors")
    for _ in range(40):
        letters = list(known.words[int(rng.integers(len(known.words)))])
        at = int(rng.integers(len(letters)))
        letters[at : at + 2] = [*"zq"][: int(rng.integers(3))]
        word = "".join(letters)
        if (found := known.corrected(word)) != word:
            others = (each for each in known.words if len(each) > 2)
            least = min(edit_distance(word, each) for each in others)
            assert edit_distance(word, found) == least


def test_words_of_templates_have_numbers() -> None:
    known = Vocabulary()
    assert {*vocabulary()} <= {*known.words} <= {*vocabulary(), *grammar().words}
    assert [known.number(word) for word in known.words] == [*range(2, len(known))]
    assert known.number("marmalade") == UNKNOWN


@pytest.mark.parametrize("kind", get_args(TextKind))
def test_a_row_does_not_depend_on_the_others(kind: str) -> None:
    encode = encoder(kind)
    alone = encode.pooled([SENTENCE])
    among = encode.pooled([OTHER, SENTENCE])
    assert torch.allclose(alone[0], among[1], atol=1e-5)
    assert not torch.allclose(among[0], among[1], atol=1e-2)


@pytest.mark.parametrize("kind", get_args(TextKind))
def test_every_weight_is_trained(kind: str) -> None:
    encode = encoder(kind).train()
    tokens, mask = encode.encode([SENTENCE, OTHER])
    assert tokens.shape[:2] == mask.shape
    (tokens * torch.randn_like(tokens)).sum().backward()
    for name, weight in encode.named_parameters():
        assert weight.grad is not None, name
        assert weight.grad.abs().sum() > 0, name


def test_case_punctuation_and_length_do_not_matter_but_order_does() -> None:
    encode = encoder()
    plain = encode.pooled([SENTENCE])
    assert torch.equal(plain, encode.pooled([SENTENCE.upper() + "!!"]))
    turned = encode.pooled(["Place the blue pad on top of the red cube"])
    assert not torch.allclose(plain, turned, atol=1e-3)
    _, mask = encode.encode(["", "?!", "red " * 100])
    assert mask.sum(1).tolist() == [1, 1, 40]


def test_an_unknown_word_is_read_by_its_meaning() -> None:
    encode = encoder("words+vectors", embedding_dropout=0.0)
    texts = [f"the blue pad is {word} it" for word in ("underline", "under", "banana")]
    underline, under, banana = encode.pooled(texts)
    assert (underline - under).norm() < (banana - under).norm()
    blind = encoder("words").pooled([texts[0], texts[2]])
    assert torch.equal(blind[0], blind[1])


def test_word_dropout_spares_colors_and_use() -> None:
    encode = encoder(word_dropout=1.0, dropout=0.0)
    other = "Grab the red tool in front of the blue robot"
    known, said = encode.pooled([SENTENCE, other])
    assert not torch.allclose(known, said, atol=1e-3)
    encode.train()
    one, two, third = encode.pooled(
        ["red on the blue", "red and one blue", "red and one pink"]
    )
    assert torch.allclose(one, two, atol=1e-5)
    assert not torch.allclose(two, third, atol=1e-3)


def test_vectors_place_words_by_meaning() -> None:
    table = word_vectors()
    assert set(vocabulary()) <= set(table.rows)
    assert table.vectors.shape[0] == len(table.rows) + 1
    assert np.linalg.norm(table.vectors, axis=1).max() < 1.05
    assert not table.vectors[0].any()
    assert "beneath" in neighbours("under")
    assert "atop" in neighbours("top")
    assert not set(neighbours("top")) & {"bottom", "under"}
    assert "above" not in neighbours("below")
    assert neighbours("qwertz") == ()


def test_paraphrases_say_the_goal_in_words_of_training() -> None:
    rng = stream("test", "paraphrase")
    none = dict.fromkeys(("ruled", "swapped", "left_out", "strange", "mistyped"), 0.0)
    mild = {**CHANCES, **none}
    said = [paraphrase("poke", GOAL, rng, mild) for _ in range(200)]
    assert len(set(said)) > 150
    for text in said:
        assert set(words(text)) <= set(vocabulary()), text
        assert {"red", "blue"} <= set(words(text)) <= set(vocabulary())
        assert not {"pink", "white", "green"} & set(words(text)), text
    two = paraphrase("pass2", TWO_GOALS, rng, mild)
    assert {"red", "blue", "white"} <= set(words(two))


PLAIN = {**dict.fromkeys(CHANCES, 0.0), "unmarked": 0.2}
UNDER = {"under", "below", "bottom"}


def only(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Paraphrase only templates of the task pass that begin with a text."""
    every = [*templates("pass", "high_level"), *templates("pass", "human")]
    found = tuple(paraphrases._parsed(t) for t in every if t.text.startswith(text))
    monkeypatch.setattr(paraphrases, "_sentences", lambda *_: found)


@pytest.mark.parametrize(("turned", "fronted"), [(1, 0), (0, 1), (1, 1), (0, 0)])
def test_a_relation_is_turned_with_its_things(
    turned: int, fronted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = {**PLAIN, "turned": turned, "fronted": fronted, "renamed": 1.0}
    rng = stream("test", "turned")
    only(monkeypatch, templates("pass", "high_level")[0].text)
    for _ in range(50):
        text = paraphrase("pass", GOAL, rng, config)
        assert bool(set(words(text)) & UNDER) == bool(turned)
        first = "red" if turned == fronted else "blue"
        assert min(("red", "blue"), key=text.index) == first, text


def test_a_place_that_comes_first_is_turned_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = stream("test", "front")
    only(monkeypatch, "on the")
    text = paraphrase("pass", GOAL, rng, {**PLAIN, "turned": 1.0})
    assert set(words(text)) & UNDER
    assert text.index("red") < text.index("blue")


@pytest.mark.parametrize("task", slow_but(SUITE, "stack", "hook"))
def test_no_paraphrase_is_a_held_out_sentence(task: str) -> None:
    goal = load_instance(task, "train", 0).goal.pairs
    held_out = {tuple(words(t.render(goal))) for t in templates(task, "unseen")}
    assert len(held_out) == 10
    rng = stream("test", "held out", task)
    said = {tuple(words(paraphrase(task, goal, rng))) for _ in range(2000)}
    assert len(said) > 1500
    assert not said & held_out


RULES_SAID: dict[str, Rule] = {
    "after": After("white_cube", "red_pad", "red_cube", "blue_pad"),
    "without": Without("robot_1"),
    "but": But("green_cube"),
    "together": Together("white_cube", "red_pad", "red_cube", "blue_pad"),
}


@pytest.mark.parametrize("kind", RULES)
def test_rules_are_worded_in_many_ways_and_in_no_held_out_one(kind: str) -> None:
    rule, robots = RULES_SAID[kind], ("blue robot", "green robot")
    rng = stream("test", "rules", kind)
    told = {say_rule_anew(rule, TWO_GOALS, SENTENCE, robots, rng) for _ in range(900)}
    assert len(told) == len(wordings()[kind])
    assert all(SENTENCE in text and "{" not in text for text in told)
    if kind in ("without", "but"):
        assert all("green" in text for text in told)
    unseen = rule_templates(kind, "unseen")
    held_out = {one.format(goal=f"{SENTENCE}.", **rule.words(robots)) for one in unseen}
    assert held_out
    assert not told & held_out
    matching = (("red_cube", "red_pad"), ("white_cube", "white_pad"))
    whole = {say_rule_anew(rule, matching, "-", robots, rng) for _ in range(900)}
    assert any("-." not in text for text in whole) == (kind == "but")


def test_leftmost_and_rightmost_are_told_apart() -> None:
    reader = SentenceReader(8, BENCHMARK)
    left, right = reader.read(["leftmost", "rightmost"], torch.device("cpu")).numbers
    assert left[1] == right[1]
    assert left[0] != right[0]
    # A word that is known stays whole.
    assert reader.read(["topmost"], torch.device("cpu")).mask.sum() == 1


def test_paraphrases_are_the_same_for_the_same_stream() -> None:
    first, second = (
        [paraphrase("hook", GOAL, rng) for _ in range(20)]
        for rng in (stream("test", "same"), stream("test", "same"))
    )
    assert first == second
