"""Attacks succeed on tables that one robot can solve, and on no frozen instance."""

from collections.abc import Iterator
from itertools import count

import pytest
from own_plugins import loaded
from soft_tables import (
    ARM,
    SOFT,
    THIN,
    THROWS,
    pad_out_of_reach,
    reach,
    soft_table,
    stack_out_of_reach,
)
from tiers import slow_but

from lemma.audit.attack import ATTACKS, Attack
from lemma.audit.control_trial import ControlTrial
from lemma.audit.run import Found, audit_instance, cheap_attacks_succeed, names_at
from lemma.audit.skill_trial import SkillTrial
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.robots.could import could_of
from lemma.scene.coasting import Coasting
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.tasks.instance import Instance
from lemma.tasks.suite import SUITE, load_instance
from lemma.viz.replay import replay_attack

QUICK = ("greedy_skills", "out_of_order")
"""One attack of most families; `drag_home` has a test of its own, others are slow."""
TEAM = tuple(name for name in ATTACKS if ATTACKS[name].team)


@pytest.fixture(autouse=True)
def _thin_pads() -> Iterator[None]:
    """Let there be thin pads, for these tests alone."""
    with loaded():
        for kind in THIN:
            OBJECT_KINDS.add(kind.name, kind)
        yield


def played(name: str, instance: Instance) -> Found:
    (found,) = audit_instance(instance, (name,))
    return found


def beyond_could() -> float:
    """How far out of grasp nobody can do anything, with something to spare [m]."""
    return could_of(ARM).place_m - reach().grasp_m + 0.10


@pytest.mark.parametrize("name", slow_but(SOFT, *QUICK))
def test_succeeds_where_one_robot_can_and_is_replayed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in THROWS:
        monkeypatch.setattr(Coasting, "is_thrown", False)
    soft = soft_table(name)
    found = played(name, soft)
    assert (found.succeeded, found.progress, found.robot) == (True, 1.0, "robot_0")
    recording = replay_attack(found, soft, frame_s=0.5)
    assert recording.success
    assert len(recording.frames) == pytest.approx(2 * recording.elapsed_s, abs=2)


@pytest.mark.slow
@pytest.mark.parametrize("name", THROWS)
def test_no_throw_succeeds_where_nothing_may_move_by_itself(name: str) -> None:
    found = played(name, soft_table(name))
    assert (found.acted, found.succeeded) == (True, False)


@pytest.mark.slow
@pytest.mark.parametrize("thrown", [True, False])
def test_a_search_throws_where_that_is_allowed(
    thrown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if thrown:
        monkeypatch.setattr(Coasting, "is_thrown", False)
    assert played("search", pad_out_of_reach(0.22)).succeeded == thrown


@pytest.mark.slow
def test_none_succeeds_where_one_robot_cannot() -> None:
    hard = stack_out_of_reach(beyond_could())
    found = list(audit_instance(hard, names_at("both")))
    assert [one.attack for one in found] == [*ATTACKS]
    assert [one.attack for one in found if one.succeeded] == []
    assert max(one.progress for one in found) == 0.0


@pytest.mark.parametrize("task", slow_but(SUITE, "pass"))
def test_out_of_order_or_with_one_skipped_no_plan_succeeds(task: str) -> None:
    """That one robot alone does not succeed is tested where lists are frozen."""
    found = list(audit_instance(load_instance(task, "test", 0), TEAM))
    assert all(one.acted for one in found)
    assert [one.attack for one in found if one.succeeded] == []


def test_cheap_attacks_say_which_of_them_succeeds() -> None:
    assert cheap_attacks_succeed(soft_table("drag_home")) == "drag_home"
    assert cheap_attacks_succeed(stack_out_of_reach(beyond_could())) is None


def test_every_attack_has_a_table_that_it_solves_and_says_what_it_does() -> None:
    assert {*ATTACKS} == {*SOFT} == {*names_at("skill"), *names_at("control")}
    for name in ATTACKS:
        assert ATTACKS[name].name == name
        assert ATTACKS[name].summary.endswith(".")
        assert "\n" not in ATTACKS[name].summary


def silent(trial: SkillTrial) -> None:
    trial.require(False)


def test_an_attack_is_checked_when_it_is_made() -> None:
    with pytest.raises(InvalidConfigError, match="silent has no docstring"):
        Attack(silent, "skill")
    silent.__doc__ = "Gives up."
    with pytest.raises(UnknownNameError, match="skill, control"):
        Attack(silent, "motor")
    with pytest.raises(InvalidConfigError, match="attempts=0"):
        Attack(silent, "skill", attempts=0)
    with pytest.raises(InvalidConfigError, match="simulated_s=0"):
        Attack(silent, "skill", simulated_s=0.0)


def test_an_attempt_ends_when_its_simulated_time_is_spent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def undo(trial: ControlTrial) -> None:
        """Waits and undoes it, for ever."""
        trial.try_each(count(), lambda number: trial.wait(1.0))

    attack = Attack(undo, "control", attempts=2, simulated_s=5.0)
    monkeypatch.setitem(ATTACKS._records, "undo", attack)
    found = played("undo", load_instance("pass", "test", 0))
    assert (found.acted, found.succeeded) == (True, False)
    assert found.simulated_s == pytest.approx(2 * 2 * 5.0, abs=0.1)


@pytest.mark.slow
def test_greedy_ends_where_there_is_nothing_to_try() -> None:
    """The second robot of this instance can do nothing at first."""
    assert not played("greedy_skills", load_instance("pass", "test", 0)).succeeded


def test_the_name_of_an_attack_is_its_function() -> None:
    silent.__doc__ = "Gives up."
    with pytest.raises(InvalidConfigError, match="Use one name"):
        ATTACKS.add("loud", Attack(silent, "skill"))
