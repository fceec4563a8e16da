"""The symbolic planner: the plan of highest utility, for any goal and any team.

States are where the cubes and the stick are and what lies on what; steps are sub-tasks
that the grounder says a robot can do. The utility of a step is the paper's u = q - c,
minus infinity where the robot cannot: q grows with the margin to the edge of reach, c
with time and with handling a thing twice. Uniform-cost search with an admissible bound
returns the plan whose summed utility is highest; nothing is scripted per task.
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
"""Cost of doing anything at all, so that a shorter plan wins."""
_PER_SECOND = 0.02
_QUALITY = 0.2
_AGAIN = 0.5
"""Cost of handling a cube that was already moved: each grasp can fail."""
_AHEAD = 0.1
"""Cost of working on a conjunct while an earlier one is open: one thing at a time."""
_LEAST = _EFFORT - _QUALITY
_MAX_EXPANSIONS = 4000


@dataclass(frozen=True)
class Plan:
    """A sequence of groundings that makes the goal true."""

    steps: tuple[GroundedOption, ...]
    utility: float
    """Sum of u over the steps."""

    @property
    def subtasks(self) -> tuple[SubTask, ...]:
        """The symbolic plan."""
        return tuple(step.subtask for step in self.steps)

    @property
    def duration_s(self) -> float:
        """Predicted time [s]."""
        return ordered_sum(step.duration_s for step in self.steps)


def utility(step: GroundedOption, before: SymbolicState, goal: Goal) -> float:
    """Return u = q - c of a step; see the constants of this module."""
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
    """Whether an object lies where somebody has put it, not pushed or dragged it."""
    return now.labels[name] in now.spec.regions or now.labels[name].startswith("on ")


def conjunct_of(name: str, now: SymbolicState, goal: Goal) -> int | None:
    """Return the first open conjunct that speaks of an object."""
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
        now: Where things are.
        goal: The goal.
        grounder: Says what can be done and what follows.
        limit_s: Largest predicted duration, the paper's T_max [s].
        team: Robots that may act; all if None.

    Returns:
        The plan; empty where the goal holds already, None where there is none, such as
        where something that the goal speaks of has fallen off the table.
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
            if step.after.key in done:
                continue
            count += 1
            total = cost - utility(step, state, goal)
            bound = round(total + _bound(step.after, goal), 9)
            heapq.heappush(queue, (bound, count, total, step.after, (*steps, step)))
    return None


def _open(conjuncts: tuple[Predicate, ...], now: SymbolicState) -> int:
    """Return how many conjuncts do not hold."""
    return len([on for on in conjuncts if not now.has(on.top, on.bottom)])


def _bound(now: SymbolicState, goal: Goal) -> float:
    """Return a cost that no way to the goal undercuts: one step per open conjunct.

    One step lays a plank on two things.
    """
    left = [on for on in goal.conjuncts if not now.has(on.top, on.bottom)]
    planks = [on.top for on in left if on.top != HAND and _is_plank(on.top)]
    return _LEAST * (len(left) - len(planks) + len(set(planks)))


def _is_plank(name: str) -> bool:
    return kind_of(name).span_m is not None


def candidates(
    now: SymbolicState, goal: Goal, robots: tuple[str, ...], grounder: GeometricGrounder
) -> Iterator[SubTask]:
    """Propose the sub-tasks that could serve the goal, whether they can be done or not.

    Args:
        now: Where things are.
        goal: The goal.
        robots: Robots that may act.
        grounder: Of the same scene.
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
    """Return the cubes worth moving, each with the places worth moving it to."""
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
    """Return the regions in which an object does not lie."""
    if name not in now.labels:
        return []
    return [region for region in now.spec.regions if region != now.labels[name]]
