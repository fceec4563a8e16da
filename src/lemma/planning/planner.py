"""The symbolic planner: finds the plan of highest utility, for any goal and any team.

A state has the poses of cubes and stick, and their supports; a step is a sub-task that
the grounder finds feasible. The utility of a step is the paper's u = q - c, and minus
infinity if the robot cannot do it: q grows with the reach margin, c with the duration
and with repeated handling of an object. Uniform-cost search with an admissible
heuristic returns the plan of highest total utility. No task has a script.
"""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

from lemma.core.seeding import ordered_sum
from lemma.planning.grounding import GeometricGrounder, GroundedOption
from lemma.planning.primitives import PRIMITIVES, Wish
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.entity import HAND, STICK, kind_of
from lemma.tasks.goal import Goal, Predicate
from lemma.tasks.subtask import Primitive, SubTask

_EFFORT = 1.0
"""Cost of every sub-task, so that shorter plans are preferred."""
_PER_SECOND = 0.02
_QUALITY = 0.2
_AGAIN = 0.5
"""Cost of handling a cube that was moved before, because each grasp can fail."""
_AHEAD = 0.1
"""Cost of working on a conjunct while an earlier one is open."""
_LEAST = _EFFORT - _QUALITY
_MAX_EXPANSIONS = 4000


@dataclass(frozen=True)
class Plan:
    """A sequence of grounded sub-tasks that achieves the goal."""

    steps: tuple[GroundedOption, ...]
    utility: float
    """Sum of the utilities u of the steps."""

    @property
    def subtasks(self) -> tuple[SubTask, ...]:
        """The symbolic sub-tasks."""
        return tuple(step.subtask for step in self.steps)

    @property
    def duration_s(self) -> float:
        """Predicted duration, one sub-task after the other [s]."""
        return ordered_sum(step.duration_s for step in self.steps)


def utility(step: GroundedOption, before: SymbolicState, goal: Goal) -> float:
    """Return the utility u = q - c of a step.

    Args:
        step: The grounded sub-task.
        before: The state before it.
        goal: The goal.
    """
    subject = step.subtask.pick
    if subject == STICK and step.subtask.place not in before.spec.regions:
        subject = step.subtask.place
    cost = _EFFORT + _PER_SECOND * (step.duration_s + step.reluctance_s)
    if step.subtask.primitive is Primitive.MOVE and _was_handled(subject, before):
        cost += _AGAIN
    rank = conjunct_of(subject, before, goal)
    if rank is not None:
        cost += _AHEAD * _open(goal.conjuncts[:rank], before)
    return _QUALITY * step.quality - cost


def _was_handled(name: str, now: SymbolicState) -> bool:
    """Return whether a robot has put an object down where it lies."""
    return now.labels[name] in now.spec.regions or now.labels[name].startswith("on ")


def conjunct_of(name: str, now: SymbolicState, goal: Goal) -> int | None:
    """Return the index of the first open conjunct that involves an object, or None."""
    for i, on in enumerate(goal.conjuncts):
        if name in (on.top, on.bottom) and not now.has(on.top, on.bottom):
            return i
    return None


def find_plan(
    now: SymbolicState,
    goal: Goal,
    grounder: GeometricGrounder,
    *,
    limit_s: float = 100.0,
    team: tuple[str, ...] | None = None,
) -> Plan | None:
    """Find the plan of highest utility.

    Args:
        now: The present state.
        goal: The goal.
        grounder: Grounder of the same scene.
        limit_s: Largest predicted duration, the paper's T_max [s].
        team: Robots that may act; all if None.

    Returns:
        The plan, which is empty if the goal holds already. None if there is no plan,
        for example because an object of the goal has fallen off the table.
    """
    if any(name in now.fallen for name in goal.entities):
        return None
    robots = team if team is not None else tuple(grounder.robots)
    queue: list[
        tuple[float, int, float, SymbolicState, tuple[GroundedOption, ...]]
    ] = []
    count = 0
    heapq.heappush(queue, (_bound(now, goal), count, 0.0, now, ()))
    done: set[tuple[tuple[str, str], ...]] = set()
    for _ in range(_MAX_EXPANSIONS):
        if not queue:
            break
        _, _, cost, state, steps = heapq.heappop(queue)
        if not _open(goal.conjuncts, state):
            return Plan(steps, -cost)
        if state.key in done:
            continue
        done.add(state.key)
        elapsed = ordered_sum(step.duration_s for step in steps)
        for subtask in candidates(state, goal, robots, grounder):
            if not goal.permits(subtask, state.has):
                continue
            step = grounder.ground(subtask, state)
            if step is None or elapsed + step.duration_s > limit_s:
                continue
            if step.partner and step.partner not in robots:
                continue
            if step.after.key in done:
                continue
            count += 1
            total = cost - utility(step, state, goal)
            bound = round(total + _bound(step.after, goal), 9)
            heapq.heappush(queue, (bound, count, total, step.after, (*steps, step)))
    return None


def _open(conjuncts: tuple[Predicate, ...], now: SymbolicState) -> int:
    """Return the number of conjuncts that do not hold."""
    return len([on for on in conjuncts if not now.has(on.top, on.bottom)])


def _bound(now: SymbolicState, goal: Goal) -> float:
    """Return a lower bound of the cost to the goal: one step per open conjunct.

    For a plank, one step makes two conjuncts true.
    """
    left = [on for on in goal.conjuncts if not now.has(on.top, on.bottom)]
    planks = [on.top for on in left if on.top != HAND and _is_plank(on.top)]
    return _LEAST * (len(left) - len(planks) + len(set(planks)))


def _is_plank(name: str) -> bool:
    return kind_of(name).span_m is not None


def candidates(
    now: SymbolicState, goal: Goal, robots: tuple[str, ...], grounder: GeometricGrounder
) -> Iterator[SubTask]:
    """Yield the sub-tasks that could serve the goal, feasible or not.

    Args:
        now: The present state.
        goal: The goal.
        robots: Robots that may act.
        grounder: Grounder of the same scene.
    """
    wanted = _wanted(now, goal)
    if STICK in now.poses and (elsewhere := _other_regions(STICK, now)):
        wanted[STICK] = elsewhere
    for item, places in wanted.items():
        able = [name for name in robots if grounder.reaches(name, now.poses[item])]
        wish = Wish(item, tuple(places), tuple(able))
        for robot in robots:
            for name in PRIMITIVES:
                yield from PRIMITIVES[name].candidates(robot, wish, now)


def _wanted(now: SymbolicState, goal: Goal) -> dict[str, list[str]]:
    """Return the objects that may need to move, each with its candidate places."""
    wanted: dict[str, list[str]] = {}
    for on in goal.conjuncts:
        if now.has(on.top, on.bottom):
            continue
        items = [name for name in (on.top, on.bottom) if name != HAND]
        wanted.setdefault(items[0], []).append(on.bottom if len(items) == 2 else HAND)
        for blocked in items:
            blocker = now.on_top_of(blocked)
            if blocker not in (None, HAND, on.top):
                wanted.setdefault(str(blocker), [])
        if len(items) == 2 and kind_of(on.bottom).cargo:
            wanted.setdefault(on.bottom, [])
    for cube, places in wanted.items():
        places += _other_regions(cube, now)
    return wanted


def _other_regions(name: str, now: SymbolicState) -> list[str]:
    """Return all regions except the one in which an object lies."""
    if name not in now.labels:
        return []
    return [region for region in now.spec.regions if region != now.labels[name]]
