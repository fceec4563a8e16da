"""Templates that a user writes: what is accepted, what is refused, and why."""

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.seeding import stream
from lemma.tasks.language.bank import parse, templates
from lemma.tasks.language.template import KINDS, LanguageBank, Template


def test_a_user_brings_plain_strings():
    bank = LanguageBank.from_strings(
        high_level=["Stack {top1} on {bottom1}, {top2} on {bottom2}"],
        human=["{top1} goes on {bottom1} and {top2} goes on {bottom2}."],
        unseen=["First {top1} atop {bottom1}, then {top2} atop {bottom2}"],
    )
    tower = (("red_cube", "blue_cube"), ("blue_cube", "white_pad"))
    for kind in KINDS:
        sentence = bank.instruct(kind, tower, stream("user"))
        assert bank.parse(sentence) == frozenset(tower)
        assert parse(sentence) is None


def test_slots_can_say_color_and_kind_apart():
    template = Template.from_string(
        "the {top.kind} that is {top.color} goes on the {bottom}"
    )
    goal = (("red_cube", "white_pad"),)
    assert template.render(goal) == "the cube that is red goes on the white pad"
    assert template.parse(template.render(goal)) == frozenset(goal)


def test_a_role_said_twice_must_be_the_same_both_times():
    template = Template.from_string("push the {top} and put the {top} on the {bottom}")
    sentence = "push the red cube and put the blue cube on the white pad"
    assert template.parse(sentence) is None


@pytest.mark.parametrize(
    ("text", "entity_kinds", "message"),
    [
        ("put the {top} on the {botom}", None, "unknown slot"),
        ("put the {top} on the {bottom", None, "unknown slot"),
        ("put the {top.hue} one on the {bottom}", None, "unknown slot"),
        ("put the {top} down", None, "needs"),
        ("put it down", None, "needs"),
        ("{top1} on {bottom1}, {top2} on it", None, "needs"),
        ("{top} on {bottom1}", None, "needs"),
        ("{top.kind} on {bottom}", None, "color"),
        ("{top.color} block on {bottom}", None, "cube or a pad"),
        ("put the {top}  on {bottom}", None, "spaces"),
        ("put the {top} on the {bottom}…", None, "ASCII"),
        ("put the {top}\non {bottom}", None, "ASCII"),
        ("please " * 30 + "put {top} on {bottom}", None, "characters"),
        ("{top} on {bottom}", [["cube", "pad"]] * 2, "one pair"),
        ("{top} on {bottom}", [["cube", "bowl"]], "Valid: cube, pad"),
        ("{top} on {bottom}", ["cube", "pad"], "list of"),
    ],
)
def test_a_bad_template_is_refused_with_a_reason(text, entity_kinds, message):
    with pytest.raises((InvalidConfigError, UnknownNameError), match=message):
        Template.from_string(text, entity_kinds)


def test_a_template_refuses_a_goal_of_another_shape():
    (template,) = templates("pass", "high_level")
    with pytest.raises(InvalidConfigError, match="is a pad"):
        template.render((("red_cube", "white_cube"),))
    with pytest.raises(InvalidConfigError, match="the goal has 2"):
        template.render((("red_cube", "white_pad"), ("blue_cube", "pink_pad")))
    with pytest.raises(UnknownNameError, match="Did you mean 'red_cube'"):
        template.render((("red_cub", "white_pad"),))


def test_a_bank_refuses_empty_kinds_repetitions_and_mixed_goals():
    with pytest.raises(InvalidConfigError, match="No 'unseen' templates"):
        LanguageBank.from_strings(["{top} on {bottom}"], ["{top} upon {bottom}"], [])
    with pytest.raises(InvalidConfigError, match="same wording"):
        LanguageBank.from_strings(
            ["{top} on {bottom}"], ["{top} upon {bottom}"], ["{top} Upon {bottom}!"]
        )
    with pytest.raises(InvalidConfigError, match="pair of roles"):
        LanguageBank.from_strings(
            ["{top} on {bottom}"],
            ["{top1} on {bottom1} and {top2} on {bottom2}"],
            ["{top} upon {bottom}"],
        )
