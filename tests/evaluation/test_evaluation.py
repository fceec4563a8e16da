"""`lemma.evaluate`: objects and names give the same lines, folders and complaints."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from faulty_policies import Keeping, Remembering
from made_up import timeless
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.evaluation.analysis.result import check_lines, read_result
from lemma.evaluation.evaluation import Evaluation, evaluate
from lemma.evaluation.lines import read_rows
from lemma.evaluation.records import EPISODES, SUMMARY
from lemma.policies.interfaces import Decision, Oracle, PolicyInput
from lemma.policies.oracle import OracleGrounder, OraclePlanner
from lemma.tasks.subtask import Primitive, SubTask

FEW: dict[str, Any] = {"tasks": ["pass", "stack"], "episodes": 1}
STOP = SubTask("", Primitive.STOP)


class Both(Oracle):
    """A planner with poses of its own, all in one object."""

    def __init__(self) -> None:
        self.planner, self.grounder, self.grounded = (
            OraclePlanner(),
            OracleGrounder(),
            0,
        )

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        return self.planner.plan(inputs)

    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[Any]:
        self.grounded += 1
        return self.grounder.ground(inputs, subtasks)

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        subtasks = self.plan(inputs)
        poses = self.ground(inputs, subtasks)
        return [
            Decision(one, None if one.primitive is Primitive.STOP else pose)
            for one, pose in zip(subtasks, poses, strict=True)
        ]


class Silent:
    """Stops at once, or says what it was told to say."""

    def __init__(self, says: str = "") -> None:
        self.says = says

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        if self.says:
            raise RuntimeError(self.says)
        return [Decision(STOP, None) for _ in inputs]


@pytest.mark.slow
def test_an_object_and_a_name_give_the_same_lines() -> None:
    by_name = lemma.evaluate("oracle", **FEW)
    planner = lemma.evaluate(OraclePlanner(), **FEW)
    assert timeless(by_name.rows) == timeless(planner.rows)
    assert by_name.success_rate == 1.0
    assert by_name.result.episodes_sha256 == planner.result.episodes_sha256
    assert planner.result.about["oracle"]


def test_the_folder_is_that_of_the_command(tmp_path: Path) -> None:
    found = lemma.evaluate(OraclePlanner(), **FEW, out=tmp_path)
    result = read_result(tmp_path / SUMMARY)
    rows = read_rows(tmp_path)
    assert result == found.result
    check_lines(result, rows, tmp_path / SUMMARY, tmp_path / EPISODES)
    # Another object of that class may be another policy: its lines are not mixed in.
    with pytest.raises(InvalidConfigError, match="another object"):
        lemma.evaluate(OraclePlanner(), **FEW, out=tmp_path)


def test_a_name_goes_on_in_its_folder(tmp_path: Path) -> None:
    first = lemma.evaluate("oracle", **FEW, out=tmp_path)
    again = lemma.evaluate("oracle", **FEW, out=tmp_path)
    # With the time that they took: nothing was played again.
    assert list(again.rows) == list(first.rows)


def test_a_module_may_be_called_as_a_planner_is() -> None:
    mine = type("Mine", (Silent,), {"__module__": "llm"})
    found = lemma.evaluate(mine(), tasks="pass", episodes=1)
    assert found.success_rate == 0.0
    assert found.result.about["policy"]["name"] == "llm:Mine"


@pytest.mark.slow
def test_a_level_says_whose_poses_they_are() -> None:
    own, given = Both(), Both()
    assert lemma.evaluate(own, level="skill", **FEW).success_rate == 1.0
    assert own.grounded > 0
    assert lemma.evaluate(given, level="plan", **FEW).success_rate == 1.0
    assert given.grounded == 0


def test_two_objects_of_one_class_are_two_policies() -> None:
    for says in ("one", "", "two"):
        found = lemma.evaluate(Silent(says), **FEW)
        assert found.success_rate == 0.0
        assert not found.result.about["oracle"]
        assert len(found.errors) == (2 if says else 0)
        assert all(says in error for error in found.errors)


def test_printed_it_is_a_table_and_says_what_went_wrong() -> None:
    kinds = ("high_level", "human")
    told = str(lemma.evaluate(Silent("<b>no</b>"), **FEW, kinds=kinds))
    lines = told.splitlines()
    assert lines[0] == "| success [%] | high-level | human |"
    assert lines[2].startswith("| pass | 0.0 (0-79) | 0.0 (0-79) |")
    assert lines[4] == "| mean of 2 tasks | 0.0 | 0.0 |"
    assert "4 of 4 episodes failed because the policy did" in told
    assert "RuntimeError: <b>no</b>" in told


@pytest.mark.parametrize(
    ("policy", "changes", "error", "told"),
    [
        (object(), {}, InvalidConfigError, "no whole policy"),
        (OraclePlanner(), {"level": "skill"}, InvalidConfigError, "no whole policy"),
        (Silent(), {"level": "plan"}, InvalidConfigError, "cannot plan"),
        (Silent(), {"level": "motor"}, UnknownNameError, "plan, skill"),
        (Silent(), {"workers": 2}, InvalidConfigError, "package.module:Class"),
        (Silent(), {"workers": 0}, InvalidConfigError, "at least 1"),
        (Silent(), {"planning": "multi-step"}, InvalidConfigError, "multi-step"),
        (Silent(), {"kinds": ("rude",)}, UnknownNameError, "high_level"),
        (Silent(), {"tasks": ("pas",)}, UnknownNameError, "pass"),
        (Silent(), {"tasks": ()}, InvalidConfigError, "Name a task"),
        (Silent(), {"kinds": ()}, InvalidConfigError, "kind of instruction"),
        (Silent, {}, InvalidConfigError, r"Silent\(\.\.\.\)"),
        ("oracle+oracle", {"level": "plan"}, InvalidConfigError, "has a grounder"),
        ("greedy-reach", {"level": "skill"}, InvalidConfigError, "no poses"),
    ],
)
def test_what_cannot_be_is_explained(
    policy: object, changes: dict[str, Any], error: type[Exception], told: str
) -> None:
    with pytest.raises(error, match=told):
        lemma.evaluate(policy, **{**FEW, **changes})


KINDS = ("high_level", "human", "unseen")


def play(policy: object, kinds: tuple[str, ...] = KINDS) -> Evaluation:
    return evaluate(policy, level="plan", tasks="pass", kinds=kinds, episodes=1)


def faults(done: Evaluation) -> list[object]:
    return [row["policy_error"] for row in done.rows]


def test_an_object_plays_each_kind_as_it_was_at_first() -> None:
    policy = Remembering()
    done = play(policy)
    assert faults(done) == [None] * 3
    assert len(policy.heard) == 1
    assert not any("keeps_state" in row for row in done.rows)


@pytest.mark.parametrize("name", slow_but(["Remembering", "Keeping"], "Keeping"))
def test_so_does_a_class_in_a_process_of_its_own(name: str) -> None:
    done = play(f"faulty_policies:{name}", KINDS[:2])
    kept = name == "Keeping"
    assert [bool(fault) for fault in faults(done)] == [False, kept]
    assert [row.get("keeps_state", False) for row in done.rows] == [kept] * 2


def test_a_policy_may_say_that_it_remembers() -> None:
    done = play(Keeping())
    first, *others = faults(done)
    assert first is None
    assert all("it remembers" in str(fault) for fault in others)
    assert all(row["keeps_state"] for row in done.rows)


def test_an_object_that_cannot_be_copied_plays_one_kind() -> None:
    policy = Remembering()
    policy.lock = threading.Lock()  # type: ignore[attr-defined]
    assert faults(play(policy, KINDS[:1])) == [None]
    with pytest.raises(InvalidConfigError, match=r"cannot be copied.*keeps_state"):
        play(policy)
