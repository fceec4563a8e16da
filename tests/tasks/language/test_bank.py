"""Every sentence asks for exactly one goal, and no two templates are the same."""

import itertools
import re
from pathlib import Path

import pytest

from lemma.core.errors import UnknownNameError
from lemma.core.seeding import stream
from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.language import bank as language
from lemma.tasks.language.template import KINDS, GoalPairs, Template
from lemma.tasks.names import SUITE

COLORS = tuple(OBJECT_COLORS)
NAMED: dict[str, Template] = {
    f"{task}-{kind}-{index}": template
    for task in SUITE
    for kind in KINDS
    for index, template in enumerate(language.templates(task, kind))
}
EVERY_TEMPLATE = list(NAMED.values())


def kinds_of(template: Template) -> tuple[tuple[str, str], ...]:
    assert template.entity_kinds is not None
    return template.entity_kinds


def goals_of(template: Template) -> list[GoalPairs]:
    """A fourth of the goals of a template with one conjunct, ten of the others."""
    if kinds_of(template) == (("cube", "pad"),):
        pairs = [*itertools.product(COLORS, COLORS)][::4]
        return [((f"{a}_cube", f"{b}_pad"),) for a, b in pairs]
    if kinds_of(template) == (("cube", "cube"),):
        pairs = [*itertools.permutations(COLORS, 2)][::4]
        return [((f"{a}_cube", f"{b}_cube"),) for a, b in pairs]
    kind = kinds_of(template)[0][1]
    return [
        ((f"{a}_cube", f"{b}_{kind}"), (f"{c}_cube", f"{d}_{kind}"))
        for a, b, c, d in list(itertools.permutations(COLORS, 4))[::12]
    ]


def named(task: str) -> list[tuple[str, Template]]:
    """Return the templates of a task, with their names."""
    return [(name, t) for name, t in NAMED.items() if name.startswith(f"{task}-")]


def texts(kind: str) -> list[Template]:
    return [template for task in SUITE for template in language.templates(task, kind)]


def blanked(template: Template) -> str:
    """The raw text with nameless slots, in lower case and without punctuation."""
    return re.sub(r"[^a-z{} ]", "", re.sub(r"\{.*?\}", "{}", template.text.lower()))


def own_words(template: Template) -> set[str]:
    return set(language.words(re.sub(r"\{.*?\}", " ", template.text)))


# --- How many, and all different --------------------------------------------------


@pytest.mark.parametrize("task", SUITE)
def test_counts(task):
    counts = [len(language.templates(task, kind)) for kind in KINDS]
    assert counts == [1, 10, 10]


def test_human_and_unseen_templates_are_all_different():
    templates = texts("human") + texts("unseen")
    assert len(templates) == 160
    assert len({template.wording() for template in templates}) == 160
    assert len({blanked(template) for template in templates}) == 160
    high_level = {template.wording() for template in texts("high_level")}
    assert not high_level & {template.wording() for template in templates}


def test_tasks_that_differ_only_in_reach_share_their_high_level_instruction():
    said = {task: language.templates(task, "high_level") for task in SUITE}
    assert said["pass"] == said["poke"] == said["hook"]
    assert said["stack"] == said["poke_stack"] == said["hook_stack"]
    assert len(set(said.values())) == 4


def test_high_level_instructions_say_neither_who_nor_how():
    told = set().union(*(own_words(template) for template in texts("high_level")))
    assert told == {"place", "on", "top", "of", "the", "and"}


@pytest.mark.parametrize("task", SUITE)
def test_every_unseen_template_has_a_word_that_training_lacks(task):
    known = set(language.vocabulary())
    for template in language.templates(task, "unseen"):
        assert own_words(template) - known, template.text


# --- One sentence, one goal ---------------------------------------------------------


@pytest.mark.parametrize("task", SUITE)
def test_templates_agree_on_the_goal_and_are_plain_and_short(task):
    for name, template in named(task):
        for goal in goals_of(template):
            sentence = template.render(goal)
            said = {other.parse(sentence) for other in EVERY_TEMPLATE} - {None}
            assert said == {frozenset(goal)}, name
            assert sentence.isascii(), name
            assert len(sentence) <= 200, name
            assert not set("{}_") & set(sentence), name
            for entity in itertools.chain(*goal):
                assert entity.split("_")[0] in language.words(sentence), name


def test_parse_is_the_inverse_of_render() -> None:
    """In any case of letters; the colors of the roles are drawn."""
    for name, template in NAMED.items():
        drawn = stream("language", name).permutation(len(COLORS))
        colors = iter([COLORS[number] for number in drawn])
        goal = tuple(
            (f"{next(colors)}_{top}", f"{next(colors)}_{bottom}")
            for top, bottom in kinds_of(template)
        )
        sentence = template.render(goal)
        assert language.parse(f"  {sentence.upper()}! ") == frozenset(goal), name


# An English reader that knows nothing of roles: what follows "on" is below, what
# follows "under" is above. Each mention must keep that promise.
MENTION = r"(?:the |its |round |one that is |\w+ that is |(?:block|cube|box) )*{(\w+)"
SLOT_THEN = r"{(\w+)[.\w]*}(?: cube)?(?: is)? "
BELOW = (
    r"\b(?:on top of|on|onto|upon|atop|over|above|upper face of) " + MENTION,
    SLOT_THEN + r"(?:at the bottom|as the base|the base|lowermost|below(?= and))",
)
ABOVE = (
    r"\b(?:under|underneath|below|beneath|supports?|bear) " + MENTION,
    SLOT_THEN + r"(?:cube )?(?:on top\b(?! of the)|uppermost|rests on it|upon it)",
)


def read_by_preposition(text: str) -> set[tuple[str, str]]:
    """(place, role) pairs that prepositions tell, whatever the roles are called."""
    return {
        (place, role.rstrip("12"))
        for place, patterns in (("bottom", BELOW), ("top", ABOVE))
        for pattern in patterns
        for role in re.findall(pattern, text.lower())
    }


def test_prepositions_agree_with_the_roles() -> None:
    read = [read_by_preposition(template.text) for template in EVERY_TEMPLATE]
    assert sum(not pairs for pairs in read) <= 6
    assert all(place == role for pairs in read for place, role in pairs)


def test_parse_knows_only_what_the_templates_say():
    assert language.parse("make me a sandwich") is None
    assert language.parse("Place the red cube on top of the red cube") is None
    assert language.parse("Place the yellow cube on top of the red pad") is None
    assert language.parse("") is None


# --- Drawing --------------------------------------------------------------------------


def test_instruct_is_a_function_of_the_stream():
    goal = (("red_cube", "white_pad"),)
    drawn = {
        language.instruct("pass", "human", goal, stream("language", index))
        for index in range(200)
    }
    assert drawn == {t.render(goal) for t in language.templates("pass", "human")}
    again = [
        language.instruct("hook", "unseen", goal, stream("language", 7))
        for _ in range(2)
    ]
    assert again[0] == again[1]


@pytest.mark.parametrize("kind", KINDS)
def test_one_draw_takes_one_integer_from_the_stream(kind):
    rng, other = stream("language", 1), stream("language", 1)
    bank = language.bank_for("stack")
    sentence = bank.instruct(kind, (("red_cube", "blue_cube"),), rng)
    index = int(other.integers(len(bank.templates(kind))))
    expected = bank.templates(kind)[index].render((("red_cube", "blue_cube"),))
    assert sentence == expected
    assert rng.random() == other.random()


def test_unknown_names_get_an_answer():
    with pytest.raises(UnknownNameError, match="Did you mean 'poke_stack'"):
        language.bank_for("poke_stak")
    with pytest.raises(UnknownNameError, match="high_level, human, unseen"):
        language.templates("pass", "robot")


# --- Words ----------------------------------------------------------------------------


def test_words():
    assert language.words("I'd like: the L-shaped thing, PLEASE!") == (
        "i'd",
        "like",
        "the",
        "l-shaped",
        "thing",
        "please",
    )


def test_vocabulary_covers_training_and_nothing_else():
    vocabulary = language.vocabulary()
    assert list(vocabulary) == sorted(set(vocabulary))
    known = set(vocabulary)
    for template in texts("high_level") + texts("human"):
        for goal in goals_of(template)[:3]:
            assert set(language.words(template.render(goal))) <= known
    for colors in (("red", "white"), ("red", "red")):
        for robot in language.robot_phrases_in_order(colors):
            said = language.sub_instruction(robot, "move", "green_cube", "shared")
            assert set(language.words(said)) <= known
    assert "atop" not in known


# --- The page about it ----------------------------------------------------------------

PAGE = (Path(__file__).parents[3] / "docs" / "language.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
def test_the_code_of_the_page_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    order = GenerateConfig(
        out=Path("data/lemma-v3"), tasks=("pass",), splits=("train",), episodes=1
    )
    generate(order, Serial())
    exec(code, {})


def test_the_page_shows_the_high_level_instructions():
    on_pads = (("red_cube", "white_pad"), ("blue_cube", "green_pad"))
    on_cubes = (("red_cube", "white_cube"), ("blue_cube", "green_cube"))
    for task in SUITE:
        (template,) = language.templates(task, "high_level")
        goal = on_pads if kinds_of(template)[0][1] == "pad" else on_cubes
        assert f"| {template.render(goal[: len(template.roles)])} |" in PAGE
