"""Blind instructions: sound, drawn for evaluation alone, and read by nothing else.

Failures here print no sentence, so that developers of a reader may run these tests.
"""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.dataset.instructions import TRAINING_KINDS, Language, draw_instruction
from lemma.evaluation.protocol.language_controls import control_of
from lemma.evaluation.run.config import EvaluationConfig
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language import bank, blind
from lemma.tasks.language.blind import (
    blind_templates,
    check_blind,
    instruction,
    kinds_of,
)
from lemma.tasks.language.template import (
    BLIND,
    EVALUATION_KINDS,
    KINDS,
    GoalPairs,
    Template,
)
from lemma.tasks.suite import SUITE, load_instance

ROOT = Path(__file__).parents[3]
PAIRS: GoalPairs = (("red_cube", "white_pad"),)
OTHERS = [
    template
    for task in SUITE
    for kind in KINDS
    for template in bank.templates(task, kind)
]
READ_BY = {
    "src/lemma/env/base_env.py",
    "src/lemma/env/config.py",
    "src/lemma/env/observation.py",
    "src/lemma/evaluation/run/config.py",
    "src/lemma/evaluation/protocol/language_controls.py",
    "src/lemma/evaluation/protocol/rules.py",
    "src/lemma/evaluation/run/rollout.py",
    "src/lemma/cli/evaluate.py",
    "scripts/measure_refusals.py",
}
"""Every file of the package and the scripts that may import it: environments say the
sentence, evaluations too, and a script counts which ones a finished reader refuses."""


@pytest.fixture
def other_words(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put one other template in the place of each task's."""
    texts = {
        task: [
            {
                **written[0],
                "text": " ".join(
                    f"{{{pick}}} bruzzel {{{place}}}"
                    for pick, _, place in written[0]["goal"]
                ),
            }
        ]
        for task, written in blind._as_written().items()
    }
    monkeypatch.setattr(blind, "_as_written", lambda: texts)
    blind._drawn.cache_clear()
    yield
    blind._drawn.cache_clear()


def goals(template: Template) -> list[GoalPairs]:
    """Return some goals that a template can say, each color in each place."""
    kinds = template.entity_kinds or ()
    count = 2 * len(kinds)
    colors = list(itertools.permutations(OBJECT_COLORS, count))
    return [
        tuple(
            (f"{drawn[2 * i]}_{top}", f"{drawn[2 * i + 1]}_{bottom}")
            for i, (top, bottom) in enumerate(kinds)
        )
        for drawn in colors[:: len(colors) // 20]
    ]


# --- The templates -----------------------------------------------------------------


def test_there_are_forty_of_each_task_and_no_two_are_the_same() -> None:
    counts = {task: len(blind_templates(task)) for task in SUITE}
    assert counts == dict.fromkeys(SUITE, 40)
    wordings = [t.wording() for task in SUITE for t in blind_templates(task)]
    assert len(set(wordings)) == 320
    repeated = sum(other.wording() in set(wordings) for other in OTHERS)
    assert repeated == 0


@pytest.mark.slow
@pytest.mark.parametrize("task", slow_but(SUITE, "stack2"))
def test_each_asks_for_one_goal_whichever_template_reads_it(task: str) -> None:
    every = [*OTHERS, *(t for name in SUITE for t in blind_templates(name))]
    misread = 0
    for template in blind_templates(task):
        for goal in goals(template)[::20]:
            said = {other.parse(template.render(goal)) for other in every} - {None}
            misread += said != {frozenset(goal)}
    assert misread == 0


@pytest.mark.parametrize("task", SUITE)
def test_they_are_of_the_form_of_the_goal(task: str) -> None:
    goal = load_instance(task, "test", 0).goal.pairs
    found = {template.entity_kinds for template in blind_templates(task)}
    bottoms = {bottom.rpartition("_")[2] for _, bottom in goal}
    assert found == {(("cube", *bottoms),) * len(goal)}


# --- Instances that have one -------------------------------------------------------


@pytest.mark.parametrize("task", slow_but(SUITE, "stack"))
def test_instances_for_evaluation_have_one_and_always_the_same(task: str) -> None:
    drawn = set()
    for split, index in itertools.product(("val", "test"), range(40)):
        instance = load_instance(task, split, index)
        sentence = instruction(instance, BLIND)
        blind._drawn.cache_clear()
        same = instruction(load_instance(task, split, index), BLIND) == sentence
        assert same
        wordings = [
            template.wording()
            for template in blind_templates(task)
            if template.parse(sentence) == frozenset(instance.goal.pairs)
        ]
        assert len(wordings) == 1
        drawn.update(wordings)
    # Of 40, by 80 draws: 34.7 on average.
    assert len(drawn) > 25


def test_sampled_instances_have_one_too() -> None:
    instance = load_instance("stack", "free", 3)
    said = [t.parse(instruction(instance, BLIND)) for t in blind_templates("stack")]
    assert said.count(frozenset(instance.goal.pairs)) == 1


@pytest.mark.parametrize("task", SUITE)
def test_instances_for_training_have_none(task: str) -> None:
    for index in range(0, SPLITS["train"], 100):
        instance = load_instance(task, "train", index)
        with pytest.raises(InvalidConfigError, match="only high_level, human, unseen"):
            instruction(instance, BLIND)
    assert kinds_of((task,), "train") == KINDS
    assert kinds_of((task,), "free") == kinds_of(SUITE, "test") == EVALUATION_KINDS


def test_environments_and_evaluations_for_training_are_refused() -> None:
    with pytest.raises(InvalidConfigError, match="'train' have no 'blind'"):
        lemma.make("stack", instruction=BLIND)
    env = lemma.make("stack", instruction=BLIND, split="val", index=0)
    with pytest.raises(InvalidConfigError, match="no instruction of the kind 'blind'"):
        env.reset(options={"split": "train"})
    policy = PolicySpec("oracle")
    config = EvaluationConfig(out=Path("out"), policy=policy, kinds=(BLIND,))
    assert config.kinds == (BLIND,)
    with pytest.raises(InvalidConfigError, match="'train' have no 'blind'"):
        EvaluationConfig(
            out=Path("out"), policy=policy, split="train", kinds=EVALUATION_KINDS
        )


def test_tasks_of_others_have_none() -> None:
    assert kinds_of((*SUITE, "tidy_up"), "free") == KINDS
    with pytest.raises(InvalidConfigError, match="for evaluation, of pass, pass2"):
        check_blind("tidy_up", "free")


def test_nothing_for_training_takes_the_kind() -> None:
    assert BLIND not in KINDS
    with pytest.raises(InvalidConfigError, match="not drawn for training"):
        draw_instruction("pass", PAIRS, "key", kinds=(*TRAINING_KINDS, BLIND))
    with pytest.raises(UnknownNameError, match="high_level, human, unseen"):
        Language(kind=BLIND)
    with pytest.raises(UnknownNameError, match="high_level, human, unseen"):
        bank.templates("pass", BLIND)


# --- Uses of them ------------------------------------------------------------------


def test_data_of_instances_do_not(other_words: None) -> None:
    for task in SUITE:
        instance = load_instance(task, "test", 7)
        assert "bruzzel" in instruction(instance, BLIND)
        assert set(instance.to_dict()["instructions"]) == set(KINDS)
        again = Instance.from_dict(instance.to_dict())
        assert instruction(again, BLIND) == instruction(instance, BLIND)
        assert "bruzzel" not in str(instance.to_dict())


def test_controls_say_the_same_words_with_other_colors(other_words: None) -> None:
    instance = load_instance("pass2", "test", 3)
    swapped = control_of("swapped", instance, BLIND)
    assert swapped.asks == control_of("swapped", instance, "human").asks
    assert "bruzzel" in (swapped.sentence or "")
    assert swapped.sentence != instruction(instance, BLIND)


def test_no_other_file_reads_them() -> None:
    folders = ("src", "scripts", "examples", "docs")
    texts = {
        str(path.relative_to(ROOT)): path.read_text("utf-8")
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
    }
    package = r"^\s*(?:from|import) lemma\.tasks\.language"
    imported = re.compile(package + r"(?:\.blind| import .*\bblind)\b", re.MULTILINE)
    assert {name for name in texts if imported.search(texts[name])} == READ_BY
    opening = [name for name, text in texts.items() if "blind.json" in text]
    assert opening == ["src/lemma/tasks/language/blind.py"]
