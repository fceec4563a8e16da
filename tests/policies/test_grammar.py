"""Sentences by rules: they name what the goal asks for, and nothing is undefined."""

import re

import numpy as np
import pytest

from lemma.core.seeding import stream
from lemma.policies.text.grammar import Grammar, grammar, speaks_of
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.language.bank import words
from lemma.tasks.language.template import GoalPairs

GOALS: dict[str, GoalPairs] = {
    "pad": (("red_cube", "blue_pad"),),
    "cube": (("red_cube", "blue_cube"),),
    "pads": (("red_cube", "blue_pad"), ("white_cube", "green_pad")),
    "cubes": (("red_cube", "blue_cube"), ("white_cube", "green_cube")),
}
WORDS = {
    "cube": ["block"],
    "pad": ["mat"],
    "verbs": ["put puts putting put", "lay lays laying laid"],
    "on": ["on", "upon"],
}


def made(rules: dict[str, list[str]], goal: str, draws: int = 40) -> set[str]:
    rng = stream("test", "grammar")
    small = Grammar(WORDS | rules)
    return {small.say(GOALS[goal], rng) for _ in range(draws)}


@pytest.mark.parametrize("goal", GOALS)
def test_sentences_name_all_that_the_goal_asks_for_in_many_ways(goal: str) -> None:
    rng = stream("test", "rules", goal)
    colors = {name.split("_")[0] for pair in GOALS[goal] for name in pair}
    said = [grammar().say(GOALS[goal], rng) for _ in range(3000)]
    for text in said:
        assert colors <= set(words(text.replace("'s", ""))), text
        assert not re.search(r"[{}@]\d|<[a-z]|  ", text), text
    assert len(set(said)) > 2900
    assert np.mean([len(text.split()) for text in said]) < 30
    for word in ("put", "please", "under", "should"):
        share = np.mean([word in words(text) for text in said])
        assert share > 0.01, word


def test_every_rule_can_be_followed() -> None:
    for name, rule in grammar().rules.items():
        assert rule.options, name
        for part in (part for option in rule.options for part in option):
            if isinstance(part, re.Match) and part["name"]:
                known = {*grammar().rules, "wcube", "wcubes", "wbottom", "wbottoms"}
                assert part["name"] in known, part.string
        # Rules that refer to each other would never end.
        place = name.removesuffix("_cubes").removesuffix("_pad")
        for part in (part for option in rule.options for part in option):
            if place != name and isinstance(part, re.Match):
                assert part["name"] != place, name
    for name in ("verbs", "sits", "holds", "takes", "reaches"):
        for option in grammar().rules[name].options:
            assert len(str(option[0]).split()) % 4 == 0, option


def test_tops_and_bottoms_are_told_apart() -> None:
    said = made({"one": ["{T.} {B.}"], "two": ["{T1.} {B1.} {T2.} {B2.}"]}, "pad")
    assert said == {"red blue"}
    both = made({"one": ["-"], "two": ["{T1.} {B1.} {T2.} {B2.}"]}, "cubes")
    assert both == {"red blue white green", "white green red blue"}
    clause = ["<part@1> <part@2>"]
    assert made({"two": clause, "part": ["{B.} {T.}"]}, "pads") == {
        "blue red green white",
        "green white blue red",
    }


def test_a_tagged_word_is_the_same_throughout_and_verbs_are_inflected() -> None:
    said = made({"one": ["<verbs/ing:v> {T.} <on:a> {B.} <on:a>"]}, "cube")
    assert said == {
        f"{verb} red {on} blue {on}"
        for verb in ("putting", "laying")
        for on in ("on", "upon")
    }
    free = made({"one": ["<on> {T.} <on> {B.}"]}, "cube")
    assert len(free) == 4


def test_what_depends_on_the_bottom() -> None:
    rules = {"one": ["any"], "one_cubes": ["cubes"], "at": ["on"], "at_pad": ["in"]}
    assert made(rules, "cube") == {"cubes"}
    assert made(rules, "pad") == {"any"}
    assert made({"one": ["<at>"], **rules, "one_cubes": ["<at>"]}, "cube") == {"on"}
    assert made(rules | {"one": ["<at>"]}, "pad") == {"in"}


def test_rules_that_are_left_out_are_not_spoken_of() -> None:
    rules = WORDS | {"one": ["<a>", "2* <b>"], "a": ["{T.}"], "b": ["{B.}"]}
    rng = stream("test", "without")
    left = Grammar(rules, without=("b",))
    assert {left.say(GOALS["pad"], rng) for _ in range(20)} == {"red"}


def test_what_is_not_asked_for_is_never_called_so() -> None:
    for text in made({"one": ["{X}"]}, "pad", 200):
        color, noun = text.split()[-2:]
        assert color in OBJECT_COLORS
        assert (color, noun) not in {("red", "block"), ("blue", "mat")}


def test_goals_that_the_rules_cannot_say() -> None:
    assert all(speaks_of(goal) for goal in GOALS.values())
    assert not speaks_of((*GOALS["pads"], ("pink_cube", "red_pad")))
    assert not speaks_of((("red_cube", "stick"),))
