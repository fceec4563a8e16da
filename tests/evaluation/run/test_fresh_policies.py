"""A policy takes nothing from one kind of sentence to the next, unless it says so."""

import threading

import pytest
from faulty_policies import Keeping, Remembering

from lemma.core.errors import InvalidConfigError
from lemma.evaluation.evaluation import Evaluation, evaluate

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


@pytest.mark.parametrize("name", ["Remembering", "Keeping"])
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
