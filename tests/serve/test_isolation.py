"""Other people's classes live in processes that may hang, crash and leave."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from faulty_policies import BAD, MOVE, given, moved, view
from interpreter import python
from tiers import slow_but

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.loading import load_policy
from lemma.policies.compose import PlannerWithGrounder
from lemma.policies.interfaces import Grounder, PastStep, Planner, Policy
from lemma.policies.spec import PolicySpec
from lemma.serve.conversation import ProtocolMode, Remote
from lemma.serve.faults import (
    FaultKind,
    PolicyFailedError,
    PolicyUnreachableError,
)
from lemma.serve.isolation import isolate

LONG_S = 60.0
LONG_PATIENCE = ProtocolMode(LONG_S)


@pytest.fixture(scope="module")
def sound() -> Iterator[Remote]:
    policy = isolate("faulty_policies:Scripted", LONG_S)
    yield policy
    policy.close()


def test_it_decides_as_it_would_here(sound: Policy) -> None:
    here = load_policy(PolicySpec("faulty_policies:Scripted", timeout_s=0.0))
    first = view(1, 20, 30)
    inputs = [
        given("go", now=first),
        given("go on", PastStep(first, MOVE, "dropped"), now=view(2, 20, 30)),
        given("go on", PastStep(first, MOVE), PastStep(view(3), MOVE), now=view(4)),
    ]
    assert sound.act(inputs) == here.act(inputs)
    assert not isinstance(here, Remote)


def test_it_has_the_methods_that_the_class_has(sound: Policy) -> None:
    assert isinstance(sound, Policy)
    assert not isinstance(sound, Planner)
    both = load_policy(PolicySpec("faulty_policies:Plans+faulty_policies:Grounds"))
    assert isinstance(both, PlannerWithGrounder)
    assert isinstance(both.planner, Planner)
    assert isinstance(both.grounder, Grounder)
    assert not isinstance(both.planner, Policy)
    found = both.act([given(), given("lost"), given("go", PastStep(view(), MOVE))])
    assert [d.grounded is None for d in found] == [False, True, True]
    assert [d.stops for d in found] == [False, False, True]


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("Raises", FaultKind.RAISED, "KeyError: 'no such thing'"),
        ("Crashes", FaultKind.DIED, "signal 11"),
        pytest.param("Leaves", FaultKind.DIED, "exit code 3", marks=pytest.mark.slow),
    ],
)
def test_faults_are_named(name: str, kind: FaultKind, words: str) -> None:
    policy: Any = isolate(f"faulty_policies:{name}", LONG_S)
    with pytest.raises(PolicyFailedError, match=words) as failed:
        policy.act([given(BAD)])
    assert failed.value.kind is kind
    # In a new process, if the old one is gone.
    assert policy.act([given()]) == [moved()]
    policy.close()


def test_a_process_that_the_system_kills_is_no_fault_of_the_policy() -> None:
    policy: Any = isolate("faulty_policies:IsKilled", LONG_S)
    with pytest.raises(PolicyUnreachableError, match="memory"):
        policy.act([given(BAD)])
    policy.close()


@pytest.mark.parametrize("name", slow_but(["Hangs", "HangsForGood"], "HangsForGood"))
def test_what_hangs_is_killed_and_begun_again(name: str) -> None:
    policy: Any = isolate(f"faulty_policies:{name}", 0.5)
    with pytest.raises(PolicyFailedError, match=r"within 0\.5 s") as failed:
        policy.act([given(BAD)])
    assert failed.value.kind is FaultKind.TIMEOUT
    policy.conversation.mode = LONG_PATIENCE
    assert policy.act([given()]) == [moved()]
    policy.close()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("faulty_policies:CannotBeMade", "OSError: no weights"),
        ("faulty_policies:Missing", "There is no"),
        *slow_but(
            [("no_such_module:Policy", "mypackage"), ("collections:Counter", "no act")]
        ),
    ],
)
def test_what_cannot_be_made_is_explained_before_the_run(name: str, words: str) -> None:
    with pytest.raises(InvalidConfigError, match=words):
        load_policy(PolicySpec(name))


@pytest.mark.parametrize("timeout_s", [-1.0, float("nan"), float("inf")])
def test_times_are_checked(timeout_s: float) -> None:
    with pytest.raises(InvalidConfigError, match="positive"):
        PolicySpec("faulty_policies:Scripted", timeout_s=timeout_s)


@pytest.mark.parametrize("crashes", [False, True])
def test_processes_that_a_policy_starts_end_with_it(crashes: bool) -> None:
    policy: Any = isolate("faulty_policies:StartsProcesses", LONG_S)
    [decision] = policy.act([given()])
    child = int(decision.explanation)
    os.kill(child, 0)
    if crashes:
        # The child holds the pipe open.
        with pytest.raises(PolicyFailedError, match="exit code 3"):
            policy.act([given(BAD)])
    policy.close()
    end = time.monotonic() + 10.0
    while _runs(child):
        assert time.monotonic() < end
        time.sleep(0.05)


def _runs(pid: int) -> bool:
    """Whether a process is there and no zombie that nobody has waited for."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.mark.slow
def test_a_class_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_policy.py").write_text(
        "from faulty_policies import Scripted\nclass Own(Scripted): pass"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for timeout_s in (0.0, LONG_S):
        policy = load_policy(PolicySpec("own_policy:Own", timeout_s=timeout_s))
        assert policy.act([given()])
    policy.close()


@pytest.mark.slow
def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "play.py"
    line = 'lemma.serve.isolation.isolate("collections:Counter", 9.0)'
    script.write_text(f"import lemma.serve.isolation\n{line}\n")
    done = python(script)
    assert "under 'if __name__ == \"__main__\":'" in done.stderr
    assert "lemma serve" not in done.stderr
