"""A task of one's own on the command line: with --plugin, every verb knows it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from command import run as command
from own_plugins import EXAMPLES, loaded

import lemma
from lemma.cli.main import split_plugins
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.dataset.instructions import draw_instruction
from lemma.dataset.recipe.generate import GenerateConfig
from lemma.evaluation.run.config import EvaluationConfig
from lemma.policies.spec import PolicySpec
from lemma.tasks.instance import BENCHMARK_VERSION
from lemma.tasks.language.bank import bank_for
from lemma.tasks.names import SUITE, in_order

FREE = f"{BENCHMARK_VERSION}/pile/free/"

PILE = EXAMPLES / "10_write_a_task.py"


def run(
    capsys: pytest.CaptureFixture[str], *words: object, processes: bool = False
) -> tuple[int, str, str]:
    code = command(*words, processes=processes)
    out, err = capsys.readouterr()
    return int(code or 0), out, err


@pytest.mark.parametrize(
    ("words", "others", "plugins"),
    [
        ("tasks", "tasks", ""),
        ("--plugin a tasks", "tasks", "a"),
        ("tasks --plugin a,b --json --plugin=c.py", "tasks --json", "a b c.py"),
        ("tasks --plugin", "tasks", ""),
    ],
)
def test_option_stands_anywhere(words: str, others: str, plugins: str) -> None:
    assert split_plugins(words.split()) == (others.split(), plugins.split())


def test_a_bad_plugin_is_an_error_of_the_command(capsys) -> None:
    code, _, err = run(capsys, "tasks", "--plugin", "no_such_module")
    assert code == 2
    assert "The plugin no_such_module cannot be loaded" in err


def test_own_task_is_listed_and_asked_for(capsys) -> None:
    with loaded(PILE):
        _, out, _ = run(capsys, "tasks", "--json")
        found = {record["task"]: record for record in json.loads(out)}
        assert [*found] == [*SUITE, "pile"]
        assert found["pile"]["gym_id"] == "lemma/Pile-v0"
        _, out, _ = run(capsys, "instructions", "pile", "--n", "3", "--json")
        assert all(r["instance"].startswith(FREE) for r in json.loads(out))


def test_own_task_has_environments_without_a_word_about_splits() -> None:
    with loaded(PILE):
        by_id: Any = gymnasium.make("lemma/Pile-v0", level="plan").unwrapped
        by_name = lemma.make("pile", level="plan")
        assert by_id.config == by_name.config == lemma.make("lemma/Pile-v0").config
        assert by_name.config.split == "free"
        assert by_name.reset(seed=0)[1]["instance"].startswith(FREE)
        with pytest.raises(InvalidConfigError, match=r"list 'test'.*'free'"):
            lemma.make("pile", split="test")
        with pytest.raises(InvalidConfigError, match="no frozen list 'val'"):
            by_name.reset(options={"split": "val"})
        with pytest.raises(InvalidConfigError, match="no frozen list 'val'"):
            lemma.load_instance("pile", "val", 0)


def test_own_task_is_said_in_training() -> None:
    with loaded(PILE):
        goal = lemma.load_instance("pile", "free", 0).goal.pairs
        said = {draw_instruction("pile", goal, "", epoch=i) for i in range(20)}
        assert len(said) == 2
        assert all(bank_for("pile").parse(sentence) for sentence in said)
        with pytest.raises(UnknownNameError, match="Did you mean 'pile'"):
            bank_for("pille")


def test_what_to_generate_is_checked() -> None:
    with loaded(PILE):
        with pytest.raises(InvalidConfigError, match="no frozen list 'train'"):
            GenerateConfig(out=Path(), tasks=("stack", "pile"), splits=("train",))
        with pytest.raises(InvalidConfigError, match=r"without limit.*--episodes"):
            GenerateConfig(out=Path(), tasks=("pile",), splits=("free",))
        order = GenerateConfig(
            out=Path(), tasks=("pile", "stack"), splits=("free",), episodes=900
        )
        assert order.total == 1800
    with pytest.raises(UnknownNameError, match="Unknown task 'pile'"):
        GenerateConfig(out=Path(), tasks=("pile",), splits=("free",), episodes=1)


@pytest.mark.slow
def test_own_task_is_generated_and_read_without_it(capsys, tmp_path: Path) -> None:
    data = tmp_path / "data"
    with loaded(PILE):
        code, out, err = run(
            capsys,
            *("generate", "--tasks", "pile", "--episodes", 2, "--workers", 1),
            *("--out", data),
            processes=True,
        )
    assert code == 0, err
    assert "equals the published" not in out
    code, out, _ = run(capsys, "replay", data, "--workers", 1)
    assert code == 0
    assert "All 2 episodes are reproduced to the bit" in out
    code, out, _ = run(capsys, "inspect", data, "--json")
    assert json.loads(out)["tasks"]["pile"]["episodes"] == 2


def test_order_of_tasks_does_not_depend_on_what_is_registered() -> None:
    assert in_order(["zigzag", "hook", "pile", "pass", "hook"]) == (
        *("pass", "hook", "pile", "zigzag"),
    )


@pytest.mark.parametrize("name", ["Tower", "", "two words", "a-b", "_a", "1st"])
def test_names_of_tasks_are_words(name: str) -> None:
    with pytest.raises(InvalidConfigError, match="cannot name a task"):
        lemma.Task(
            name=name,
            summary="",
            subtasks=1,
            distractors=(0, 0),
            arrange=lambda placer: lemma.TASKS["stack"].arrange(placer),
            language=bank_for("stack"),
        )


@pytest.mark.parametrize(
    ("field", "value"), [("subtasks", "x"), ("distractors", 3), ("teams", None)]
)
def test_a_field_of_another_type_is_refused_in_one_sentence(
    field: str, value: Any
) -> None:
    with pytest.raises(InvalidConfigError, match=f"{field} is .*, and must be"):
        replace(lemma.TASKS["stack"], **{field: value})


def test_gymnasium_knows_one_task_by_one_name() -> None:
    other = replace(lemma.TASKS["stack2"], name="stack_2")
    with loaded(), pytest.raises(InvalidConfigError, match=r"Stack2-v0.*'stack2'"):
        lemma.TASKS.add("stack_2", other)


@pytest.mark.slow
def test_own_task_is_evaluated_and_reported_without_it(capsys, tmp_path: Path) -> None:
    result = tmp_path / "result"
    with loaded(PILE):
        code, out, err = run(
            capsys,
            *("evaluate", "--policy", "oracle", "--tasks", "pile", "--episodes", 2),
            *("--workers", 1, "--out", result, "--json"),
        )
    assert code == 0, err
    assert json.loads(out)["high_level"]["pile"]["successes"] == 2
    code, out, _ = run(capsys, "compare", result, result, "--json")
    assert json.loads(out)["high_level"]["pile"]["both"] == 2
    code, _, err = run(capsys, "report", result, "--out", tmp_path / "report")
    assert code == 0, err
    tables = (tmp_path / "report" / "results.md").read_text()
    assert "| success [%] | pile | mean |" in tables
    assert "2 episodes of pile" in tables


def test_what_to_evaluate_is_checked() -> None:
    policy = PolicySpec("oracle")
    with loaded(PILE):
        with pytest.raises(InvalidConfigError, match="no frozen list 'test'"):
            EvaluationConfig(out=Path(), policy=policy, tasks=("pile",))
        with pytest.raises(InvalidConfigError, match=r"without a limit.*--episodes"):
            EvaluationConfig(out=Path(), policy=policy, split="free")
    with pytest.raises(UnknownNameError, match="Unknown task 'pile'"):
        EvaluationConfig(out=Path(), policy=policy, tasks=("pile",))
