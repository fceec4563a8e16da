"""Attacks have teeth: where one robot can do it they do, and nowhere else."""

from collections.abc import Iterator

import pytest
from own_plugins import loaded
from soft_tables import ARM, SOFT, THIN, reach, soft_table, stack_out_of_reach
from tiers import slow_but

from lemma.audit.attack import ATTACKS
from lemma.audit.run import Found, audit_instance, cheap_attacks_succeed, names_at
from lemma.robots.could import could_of
from lemma.scene.objects.kind import OBJECT_KINDS
from lemma.tasks.instance import Instance


@pytest.fixture(autouse=True)
def _thin_pads() -> Iterator[None]:
    """Let there be thin pads, for these tests alone."""
    with loaded():
        for kind in THIN:
            OBJECT_KINDS.add(kind.name, kind)
        yield


QUICK = ("drag_home", "rake", "throw")


def played(name: str, instance: Instance) -> Found:
    (found,) = audit_instance(instance, (name,))
    return found


def beyond_could() -> float:
    """How far out of grasp nobody can do anything, with something to spare [m]."""
    return could_of(ARM).place_m - reach().grasp_m + 0.10


@pytest.mark.parametrize("name", slow_but(SOFT, *QUICK))
def test_succeeds_where_one_robot_can(name: str) -> None:
    found = played(name, soft_table(name))
    assert (found.succeeded, found.progress, found.robot) == (True, 1.0, "robot_0")


@pytest.mark.slow
def test_none_succeeds_where_one_robot_cannot() -> None:
    hard = stack_out_of_reach(beyond_could())
    found = list(audit_instance(hard, names_at("both")))
    assert [one.attack for one in found] == [*ATTACKS]
    assert [one.attack for one in found if one.succeeded] == []
    assert max(one.progress for one in found) == 0.0


def test_cheap_attacks_say_which_of_them_succeeds() -> None:
    assert cheap_attacks_succeed(soft_table("drag_home")) == "drag_home"
    assert cheap_attacks_succeed(stack_out_of_reach(beyond_could())) is None


def test_every_attack_has_a_table_that_it_solves() -> None:
    assert {*ATTACKS} == {*SOFT}


def test_every_attack_says_what_it_does() -> None:
    for name in ATTACKS:
        assert ATTACKS[name].name == name
        assert ATTACKS[name].summary.endswith(".")
    assert {*names_at("skill"), *names_at("control")} == {*ATTACKS}
