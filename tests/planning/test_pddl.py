"""Instances in PDDL: the planner's plans are plans of the exported problem."""

import re
from pathlib import Path

import pytest
from command import run as lemma
from tiers import slow_but

from lemma.core.errors import InvalidConfigError
from lemma.env.simulation import Simulation
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.pddl import Pddl, to_pddl
from lemma.planning.planner import Plan, find_plan
from lemma.planning.schedule import PLACED
from lemma.planning.symbolic_state import SymbolicState
from lemma.tasks.suite import load_instance

Facts = set[tuple[str, ...]]


def exported(task: str) -> tuple[Pddl, Plan]:
    instance = load_instance(task, "test", 2)
    now = SymbolicState.observe(Simulation(instance.scene).scene)
    grounder = GeometricGrounder(instance.scene)
    plan = find_plan(now, instance.goal, grounder)
    assert plan is not None
    return to_pddl("problem", now, instance.goal, grounder), plan


def facts_in(text: str) -> Facts:
    """Return the innermost lists of a text."""
    return {tuple(one.split()) for one in re.findall(r"\(([^()]+)\)", text)}


def bring(facts: Facts, robot: str, cube: str, place: str) -> tuple[str, str]:
    """Bring a cube somewhere, as the domain says; return where from and to."""
    (below,) = (f[2] for f in facts if f[:2] == ("on", cube))
    (start,) = (f[2] for f in facts if f[:2] == ("at", cube))
    ends = [f[2] for f in facts if f[:2] == ("at", place)]
    (end,) = ends or [place]
    needed = {("free", robot), ("clear", cube), ("reaches", robot, start)}
    needed |= {("reaches", robot, end)} | ({("clear", place)} if ends else set())
    assert needed <= facts
    facts -= {("on", cube, below), ("at", cube, start)}
    facts -= {("clear", place)} if ends else set()
    facts |= {("on", cube, place), ("at", cube, end), ("clear", below)}
    return start, end


@pytest.mark.parametrize(
    "task", slow_but(("relay", "tower", "carousel", "sort", "stack2"), "relay", "tower")
)
def test_the_planners_plan_solves_the_exported_problem(task: str) -> None:
    told, plan = exported(task)
    begin, _, goal = told.problem.partition("(:goal")
    facts = facts_in(begin)
    times = {(f[0], *f[1:]) for f in facts if f[0].endswith("-time")}
    for step in plan.steps:
        sub = step.subtask
        start, end = bring(facts, sub.robot, sub.pick, sub.place)
        assert ("bring-time", sub.robot, start, end) in times
    wanted = {fact for fact in facts_in(goal) if fact[0] == "on"}
    assert wanted
    assert wanted <= facts


def test_times_are_the_planners() -> None:
    told, plan = exported("relay")
    first = plan.steps[0]
    sub = first.subtask
    line = f"(bring-time {sub.robot} spot_{sub.pick} {sub.place})"
    (said,) = re.findall(re.escape(f"(= {line} ") + r"([\d.]+)\)", told.problem)
    assert float(said) == pytest.approx(PLACED * first.duration_s, abs=0.5)


@pytest.mark.parametrize("task", ["hook", "lift", "unison"])
def test_what_is_no_move_of_cubes_is_refused(task: str) -> None:
    with pytest.raises(InvalidConfigError, match="moving cubes alone"):
        exported(task)


def test_the_command_writes_files(tmp_path: Path) -> None:
    lemma("schedule", "relay", "--index", "2", "--export", str(tmp_path))
    told, _ = exported("relay")
    assert (tmp_path / "domain.pddl").read_text() == told.domain
    problem = (tmp_path / "problem.pddl").read_text()
    assert problem == told.problem.replace("problem problem", "problem v3-relay-test-2")
    assert told.domain.count("(") == told.domain.count(")")
    assert problem.count("(") == problem.count(")")
    assert (tmp_path / "instance.json").exists()
