"""Relational instructions: one reading, the goal's, whoever reads them."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from relational_reader import Reading, readings
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.evaluation.protocol.language_controls import control_of
from lemma.evaluation.run.config import EvaluationConfig
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.palette import BENCHMARK_COLORS
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import Goal, On
from lemma.tasks.instance import OWN_SPLIT, SPLITS, Instance, splits_of
from lemma.tasks.language import bank
from lemma.tasks.language.blind import instruction, kinds_of
from lemma.tasks.language.relational import (
    describe,
    relational,
    say,
    speaks_of_places,
    things_in,
)
from lemma.tasks.language.template import (
    EVALUATION_KINDS,
    KINDS,
    MAX_CHARACTERS,
    RELATIONAL,
)
from lemma.tasks.names import FAMILIES, LADDER, SUITE
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.rule import After, But, Without

TASKS = (*SUITE, *FAMILIES)
POLICY = PolicySpec("oracle")
DIGESTS = {
    "pass": "99f6d20625fa",
    "pass2": "cd211fb61ca9",
    "stack": "99289bc25dbb",
    "stack2": "cf0079eb8a99",
    "poke": "3458e289b97c",
    "poke_stack": "9036f50f9dc3",
    "hook": "5cbac5043ccd",
    "hook_stack": "effa5c388494",
    "relay": "4fcf2bc19414",
    "line": "5e37584eb150",
    "carousel": "9b8e43bd2d09",
    "sort": "0fab496e5691",
    "tower": "93627dc57922",
    "exchange": "8e51ef316797",
    "strong": "e02861975155",
    "bridge": "5c8ec7a649b0",
    "carry": "a9f116f60a42",
    "give": "00c484f99e99",
    "unison": "269fd2e42760",
}
"""First digits of the SHA-256 of the test list's sentences: they are frozen."""
PAIR = (
    RobotPlacement("ur5", "red", Pose2(-0.9, 0.0)),
    RobotPlacement("ur5", "white", Pose2(0.9, 0.0)),
)


def asked(goal: Goal) -> Reading:
    rule = goal.rule
    return frozenset(goal.pairs), () if rule is None else (rule.kind, *rule.names)


def is_relational(sentence: str) -> bool:
    return speaks_of_places(sentence) or sentence.startswith("Put every")


def scene_of(*placed: tuple[str, float, float]) -> SceneSpec:
    """Return a table for two with things at x, y, such as ``("red_cube", 0.1, 0)``."""
    objects = []
    for name, x, y in placed:
        color, _, kind = name.rpartition("_")
        objects.append(ObjectPlacement(kind, color or "yellow", Pose2(x, y)))
    return SceneSpec(PAIR, tuple(objects))


def described(scene: SceneSpec, name: str) -> list[str]:
    found = describe(things_in(scene), name)
    return [one for phrases in found.values() for one in phrases]


# --- Instances ---------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_each_of_the_test_list_has_one_reading(task: str) -> None:
    instances = [load_instance(task, "test", index) for index in range(SPLITS["test"])]
    sentences = [relational(one) for one in instances]
    for instance, sentence in zip(instances, sentences, strict=True):
        assert readings(sentence, instance.scene) == {asked(instance.goal)}, sentence
        assert sentence.isascii()
        assert len(sentence) <= MAX_CHARACTERS
    assert sum(map(is_relational, sentences)) >= 57
    digest = hashlib.sha256("\n".join(sentences).encode()).hexdigest()
    assert digest[:12] == DIGESTS[task]


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_each_of_the_other_lists_has_one_reading(task: str) -> None:
    for split in ("train", "val"):
        for index in range(splits_of(task)[split]):
            instance = load_instance(task, split, index)
            sentence = relational(instance)
            found = readings(sentence, instance.scene)
            assert found == {asked(instance.goal)}, sentence


def check_free(task: str, seed: int) -> None:
    instance = load_instance(task, "free", seed)
    sentence = relational(instance)
    assert readings(sentence, instance.scene) == {asked(instance.goal)}, sentence
    assert relational(Instance.from_dict(instance.to_dict())) == sentence


@settings(max_examples=3, deadline=None)
@given(st.sampled_from(("pass", "stack2", "relay", "tower")), st.integers(0, 10**6))
def test_free_instances_have_one_reading(task: str, seed: int) -> None:
    check_free(task, seed)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.sampled_from(TASKS), st.integers(0, 10**6))
def test_free_instances_of_all_tasks_have_one_reading(task: str, seed: int) -> None:
    check_free(task, seed)


SPOTS = st.lists(
    st.tuples(st.integers(-60, 60), st.integers(-25, 25)),
    min_size=4,
    max_size=9,
    unique=True,
)


@settings(max_examples=60, deadline=None)
@given(SPOTS, st.integers(0, 3), st.integers(0, 10**6))
def test_any_table_has_one_reading(
    spots: list[tuple[int, int]], which: int, seed: int
) -> None:
    """Things at any places of a grid of 2 cm, in rows and columns, also crowded."""
    kinds = ("cube", "pad") * 5
    colors = [color for color in BENCHMARK_COLORS for _ in range(2)]
    scene = scene_of(
        *(
            (f"{color}_{kind}", 0.02 * x, 0.02 * y)
            for color, kind, (x, y) in zip(colors, kinds, spots, strict=False)
        )
    )
    one, pad, two, other = scene.object_names[:4]
    stay = tuple(n for n in scene.object_names if n.endswith("cube"))[2:]
    goal = [
        Goal((On(one, pad), On(two, other))),
        Goal((On(one, two), On(two, pad))),
        Goal((On(one, pad), On(two, other)), Without("robot_1")),
        Goal((On(one, pad), On(two, other)), But(stay[0]) if stay else None),
    ][which]
    sentence = say(scene, goal, stream("any table", seed))
    assert readings(sentence, scene) == {asked(goal)}, sentence


# --- Descriptions ------------------------------------------------------------------


def test_words_are_those_of_the_map() -> None:
    scene = scene_of(
        ("red_cube", -0.4, 0.1), ("blue_cube", 0.0, -0.2), ("pink_cube", 0.3, 0.1)
    )
    assert set(described(scene, "blue_cube")) == {
        "second cube from the left",
        "second cube from the right",
        "cube nearest to the red cube",
        "cube nearest to the pink cube",
    }
    red, pink = described(scene, "red_cube"), described(scene, "pink_cube")
    assert {"leftmost cube", "cube left of the blue cube"} <= set(red)
    assert "cube nearest to the red robot" in red
    assert "cube left of the pink cube" not in red
    assert {"rightmost cube", "cube right of the blue cube"} <= set(pink)
    assert "cube farthest from the red robot" in pink


@pytest.mark.parametrize(
    ("enough", "too_little", "words"),
    [
        (("red_cube", 0.2, 0.0), ("red_cube", 0.22, 0.0), "nearest to the pink pad"),
        (("red_cube", 0.3, 0.0), ("red_cube", 0.28, 0.0), "farthest from the pink pad"),
        (("red_cube", 0.04, 0.3), ("red_cube", 0.02, 0.3), "right of the pink pad"),
        (("red_cube", -0.2, 0.5), ("red_cube", -0.23, 0.5), "rightmost cube"),
        (
            ("red_cube", 0.3, 0.06),
            ("red_cube", 0.3, 0.08),
            "between the white robot and the pink pad",
        ),
    ],
)
def test_there_is_a_margin(
    enough: tuple[str, float, float], too_little: tuple[str, float, float], words: str
) -> None:
    others = ("pink_pad", 0.0, 0.0), ("blue_cube", -0.25, 0.0)
    for placed, fits in ((enough, True), (too_little, False)):
        found = described(scene_of(placed, *others), "red_cube")
        assert any(words in one for one in found) == fits


def test_two_that_fit_are_described_otherwise() -> None:
    others = ("pink_pad", 0.0, 0.0), ("blue_cube", 0.5, 0.11)
    scene = scene_of(("red_cube", 0.3, 0.0), *others)
    found = described(scene, "red_cube")
    assert "cube right of the pink pad" not in found
    # The blue cube is beside the line, but too close to it.
    assert not any("white robot and the pink pad" in one for one in found)
    both = "Put the cube right of the pink pad on the pink pad"
    assert len(readings(both, scene)) == 2


def test_where_no_relation_fits_the_name_is_said() -> None:
    scene = scene_of(
        ("red_cube", 0.0, 0.01), ("blue_cube", 0.01, -0.01), ("tray", 0.0, 0.0)
    )
    assert not described(scene, "tray")
    rng = stream("names")
    crowd = scene_of(*((f"{c}_cube", 0.0, 0.0) for c in BENCHMARK_COLORS[:3]))
    goal = Goal((On("red_cube", "pink_cube"),))
    assert say(crowd, goal, rng) == "Put the red cube on the pink cube"


def test_long_goals_are_said_by_names() -> None:
    instance = load_instance("carousel", "test", 0)
    sentence = relational(instance)
    assert len(sentence) > 150
    assert any(placed.entity.phrase in sentence for placed in instance.scene.objects)


def test_a_plank_is_said_after_its_posts() -> None:
    scene = load_instance("bridge", "test", 0).scene
    goal = load_instance("bridge", "test", 0).goal
    turned = Goal.from_pairs(goal.pairs[::-1])
    sentence = say(scene, turned, stream("turned"))
    assert sentence.endswith("and the plank on both cubes")
    assert readings(sentence, scene) == {asked(goal)}


def refused_goals() -> list[tuple[Goal, str]]:
    pairs = tuple((f"{c}_cube", f"{c}_pad") for c in BENCHMARK_COLORS[:4])
    late = After(*pairs[0], *pairs[1])
    return [
        (Goal.from_pairs((("red_cube", "hand"),)), "with a hand"),
        (Goal.from_pairs(pairs, late), "not about all of the goal"),
    ]


@pytest.mark.parametrize(("goal", "why"), refused_goals())
def test_some_goals_have_none(goal: Goal, why: str) -> None:
    with pytest.raises(InvalidConfigError, match=why):
        say(scene_of(("red_cube", 0.0, 0.0)), goal, stream("refused"))


# --- Uses of them ------------------------------------------------------------------


def test_protocol_and_data_do_not_have_the_kind() -> None:
    assert RELATIONAL not in EVALUATION_KINDS
    assert kinds_of(SUITE, "test") == EVALUATION_KINDS
    instance = load_instance("sort", "test", 0)
    assert set(instance.to_dict()["instructions"]) == set(KINDS)


@pytest.mark.parametrize("split", slow_but(["train", "test", "free"], "test"))
def test_environments_say_them(split: str) -> None:
    env = lemma.make(
        "relay", level="plan", split=split, index=1, instruction=RELATIONAL
    )
    _, info = env.reset()
    assert info["instruction"] == relational(load_instance("relay", split, 1))
    env.close()


def test_tasks_of_the_ladder_have_none() -> None:
    task = next(one for one in LADDER if one not in SUITE)
    with pytest.raises(InvalidConfigError, match="no 'relational' instruction"):
        lemma.make(task, instruction=RELATIONAL)
    with pytest.raises(InvalidConfigError, match="no 'relational' instruction"):
        EvaluationConfig(
            out=Path("out"), policy=POLICY, tasks=(task,), kinds=(RELATIONAL,)
        )
    with pytest.raises(InvalidConfigError, match="no instruction of the kind"):
        instruction(load_instance(task, "test", 0), RELATIONAL)


def test_an_instance_of_your_own_has_one() -> None:
    own = replace(load_instance("pass", "test", 0), split=OWN_SPLIT)
    config = EvaluationConfig(
        out=Path("out"),
        policy=POLICY,
        tasks=("pass",),
        split=OWN_SPLIT,
        kinds=(RELATIONAL,),
        instance=own,
    )
    assert config.command().endswith("--instructions relational --instance FILE.json")
    assert readings(relational(own), own.scene) == {asked(own.goal)}


def test_swapped_sentences_ask_for_the_other_goal() -> None:
    for index in range(3):
        instance = load_instance("stack2", "test", index)
        swapped = control_of("swapped", instance, RELATIONAL)
        assert swapped.asks == control_of("swapped", instance, "human").asks
        if swapped.asks:
            found = readings(swapped.sentence or "", instance.scene)
            assert found == {(frozenset(swapped.asks), ())}
    other = control_of("shuffled", instance, RELATIONAL)
    assert other.sentence == relational(load_instance("stack2", "test", 3))
    assert other.asks is None


def test_the_page_quotes_them() -> None:
    page = (Path(__file__).parents[3] / "docs" / "language.md").read_text("utf-8")
    rows = re.findall(r"^\| (\w+), (\d+) \| (Put .*) \|$", page, re.MULTILINE)
    assert len(rows) == 6
    for task, index, said in rows:
        assert relational(load_instance(task, "test", int(index))) == said


def test_no_other_sentence_speaks_of_places() -> None:
    """So prompts of language models stay as they were for all other sentences."""
    others = [template.text for task in TASKS for template in bank.bank_for(task)]
    assert not [text for text in others if speaks_of_places(text)]
