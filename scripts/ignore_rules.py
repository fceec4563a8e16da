"""Print how often plans keep rules that they ignore, in `exchange` and in `unison`.

    python scripts/ignore_rules.py [SPLIT ...]

The plans are the expert's for the goals without their rules. The default splits are
`val` and `train`. In `exchange` plans are not executed; those for *but* always keep its
rule, because its difficulty is in the words "every cube". In `unison` they are executed
with all robots at once, in the first 40 tables of each split: as soon as possible, with
both last moves begun at once, and as the expert does it. Printed are the seconds
between the moments at which the two cubes are laid down.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

from lemma.core.seeding import ordered_sum
from lemma.env.episode import Episode
from lemma.env.team.orders import LOOK_S, Team
from lemma.expert.together import TeamWork, solve_together
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance, splits_of
from lemma.tasks.subtask import SubTask
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.rule import AT_ONCE_S

TABLES = 40
"""Number of executed tables of each split."""


def plan_keeps_rule(instance: Instance) -> bool:
    """Return whether the plan for the goal without its rule keeps the rule."""
    start = SymbolicState.observe(Scene(instance.scene))
    goal = Goal(instance.goal.conjuncts)
    plan = find_plan(start, goal, GeometricGrounder(instance.scene))
    assert plan is not None
    before = (one for one, _ in pairwise([start, *(s.after for s in plan.steps)]))
    steps = zip(plan.subtasks, before, strict=True)
    return all(instance.goal.permits(subtask, now.has) for subtask, now in steps)


def exchange_rows(splits: tuple[str, ...]) -> Iterator[str]:
    """Yield a line for each kind of rule in `exchange`."""
    tables, kept = Counter[str](), Counter[str]()
    for instance in listed("exchange", splits, None):
        assert instance.goal.rule is not None
        tables[instance.goal.rule.kind] += 1
        kept[instance.goal.rule.kind] += plan_keeps_rule(instance)
    for kind, count in tables.items():
        yield f"{kind}: kept in {kept[kind]} of {count}"


def listed(task: str, splits: tuple[str, ...], most: int | None) -> Iterator[Instance]:
    """Yield the first instances of lists of a task."""
    for split in splits:
        for index in range(splits_of(task)[split])[:most]:
            yield load_instance(task, split, index)


def apart_s(instance: Instance, play: Callable[[Episode], None]) -> float:
    """Return the time from one cube's being laid down to the other's [s].

    Raises:
        ValueError: They do not both lie on their pads in the end.
    """
    episode, laid_s = Episode(instance), dict[str, float]()
    scene = episode.simulation.scene

    def look() -> None:
        for on in instance.goal.placements:
            if on.top not in laid_s and on.lies(scene):
                laid_s[on.top] = scene.time_s

    episode.simulation.observers.append(look)
    play(episode)
    if episode.goal_progress < 1.0:
        raise ValueError(f"{instance.key} was not solved.")
    return max(laid_s.values()) - min(laid_s.values())


def solve(episode: Episode) -> None:
    """Let the expert solve an episode with all robots at once."""
    for _ in solve_together(episode):
        pass


def begin_at_once(episode: Episode) -> None:
    """Execute the expert's plan; nobody begins a last move before another one can."""
    goal, team = episode.instance.goal, Team(episode)
    plan = find_plan(team.observe(), goal, team.grounder)
    assert plan is not None
    work, last = TeamWork(team, plan.subtasks), set(goal.pairs)

    def may(subtask: SubTask) -> bool:
        is_last = (subtask.pick, subtask.place) in last
        before = (one for one in work.todo if (one.pick, one.place) not in last)
        unsettled = team.orders.keys() - team.settled(team.observe())
        others = (team.orders[robot].subtask for robot in unsettled)
        busy = (one for one in others if one and (one.pick, one.place) not in last)
        return not is_last or not any((*before, *busy))

    while work.todo or team.orders:
        work.begin_ready(may)
        work.pass_time(episode.simulation.time_s + LOOK_S)


def unison_rows(splits: tuple[str, ...]) -> Iterator[str]:
    """Yield a line for each way to execute plans in `unison`."""
    ways: tuple[tuple[str, Callable[[Episode], None], bool], ...] = (
        ("as soon as possible", solve, False),
        ("last moves begun at once", begin_at_once, False),
        ("aimed by the expert", solve, True),
    )
    tables = list(listed("unison", splits, TABLES))
    for name, play, reads in ways:
        found = [
            apart_s(one if reads else replace(one, goal=Goal(one.goal.conjuncts)), play)
            for one in tables
        ]
        kept = sum(apart <= AT_ONCE_S for apart in found)
        yield (
            f"together, {name}: kept in {kept} of {len(found)}; {min(found):.2f} to "
            f"{max(found):.2f} s apart, mean {ordered_sum(found) / len(found):.2f} s"
        )


if __name__ == "__main__":
    splits = tuple(sys.argv[1:]) or ("val", "train")
    for rows in (exchange_rows, unison_rows):
        for row in rows(splits):
            print(row, flush=True)
