"""Instances as temporal planning problems in PDDL 2.1, for external planners.

The action *bring* moves an object onto another one or into a region; its duration is
the fraction :data:`~lemma.planning.schedule.PLACED` of the predicted duration. Then the
robot *goes home* and is free again. Reach and durations are those of the planner's
geometry. The model omits the sectors that arms reserve. It also does not allow a robot
to pick up an object before the place for it is ready. So the least makespan in PDDL is
no bound for the schedules of :mod:`lemma.planning.schedule`, and its plan is not such a
schedule.
"""

from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.schedule import PLACED
from lemma.planning.symbolic_state import TABLE, SymbolicState
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.goal import Goal, On
from lemma.tasks.subtask import Primitive

DOMAIN = "lemma-teams"

_BRING = """
 (:durative-action bring-{name}
  :parameters (?r - robot ?c - cargo ?from - support ?l - place {to})
  :duration (= ?duration (bring-time ?r ?l ?m))
  :condition (and (at start (free ?r)) (at start (on ?c ?from)) (at start (at ?c ?l))
   (at start (clear ?c)) (over all (reaches ?r ?l)) (over all (reaches ?r ?m)){ready})
  :effect (and (at start (not (free ?r))) (at start (not (on ?c ?from)))
   (at start (not (at ?c ?l))) (at start (not (clear ?c))){closes}
   (at end (on ?c {below})) (at end (at ?c ?m)) (at end (clear ?c))
   (at end (clear ?from)) (at end (away ?r ?m))))
"""

_HEAD = f"""(define (domain {DOMAIN})
 (:requirements :typing :fluents :durative-actions)
 (:types robot support - object place thing - support region spot - place
  cargo pad - thing)
 (:predicates (free ?r - robot) (away ?r - robot ?l - place)
  (reaches ?r - robot ?l - place) (on ?c - cargo ?s - support)
  (at ?t - thing ?l - place) (clear ?s - support))
 (:functions (bring-time ?r - robot ?l ?m - place)
  (home-time ?r - robot ?l - place))
"""

_HOME = """
 (:durative-action go-home
  :parameters (?r - robot ?l - place)
  :duration (= ?duration (home-time ?r ?l))
  :condition (at start (away ?r ?l))
  :effect (and (at start (not (away ?r ?l))) (at end (free ?r))))
)
"""


@dataclass(frozen=True, slots=True)
class Pddl:
    """A temporal planning problem."""

    domain: str
    """The domain, which is the same for all instances."""
    problem: str


def to_pddl(
    name: str, now: SymbolicState, goal: Goal, grounder: GeometricGrounder
) -> Pddl:
    """Return an instance as a planning problem.

    Args:
        name: Name of the problem.
        now: The initial state.
        goal: The goal.
        grounder: Grounder of the same scene.

    Raises:
        InvalidConfigError: The goal involves grippers or a plank, or has a rule, a cube
            is too heavy for a robot, or no plan reaches it with ``move`` alone;
            dragging with the stick has no symbolic model.
    """
    plan = find_plan(now, goal, grounder)
    moves = plan is not None and all(
        step.primitive is Primitive.MOVE and step.pick != STICK
        for step in plan.subtasks
    )
    placed = all(
        isinstance(part, On) and kind_of(part.top).span_m is None
        for part in goal.conjuncts
    )
    heavy = any(
        grounder.overload(robot, name)
        for robot in grounder.robots
        for name in now.supports
    )
    if not moves or not placed or goal.rule is not None or heavy:
        raise InvalidConfigError(
            f"{name} cannot be expressed in PDDL: no plan reaches its goal by moving "
            "cubes alone, or a cube is too heavy for a robot. Choose an instance of a "
            "task without the stick, and without grippers, a plank, a tray, a rod or "
            "a rule in its goal, such as relay."
        )
    return Pddl(_domain(), _Problem(now, goal, grounder).text(name))


def _domain() -> str:
    onto = _BRING.format(
        name="onto",
        to="?to - thing ?m - place",
        below="?to",
        ready="\n   (over all (at ?to ?m)) (at start (clear ?to))",
        closes=" (at start (not (clear ?to)))",
    )
    into = _BRING.format(name="into", to="?m - region", below="?m", ready="", closes="")
    return _HEAD + onto + into + _HOME


class _Problem:
    """The problem file of one initial state."""

    def __init__(
        self, now: SymbolicState, goal: Goal, grounder: GeometricGrounder
    ) -> None:
        self._now, self._goal, self._grounder = now, goal, grounder
        self._things = [name for name in now.poses if name != STICK]
        self._spots = {
            f"spot_{name}": now.poses[name]
            for name in self._things
            if now.supports.get(name, TABLE) == TABLE
        }
        places = {name: one.free_spot(()) for name, one in grounder.regions.items()}
        self._regions = {name: pose for name, pose in places.items() if pose}

    def text(self, name: str) -> str:
        """Return the problem as PDDL."""
        cargo = [thing for thing in self._things if thing in self._now.supports]
        pads = [thing for thing in self._things if thing not in cargo]
        objects = (
            (self._grounder.robots, "robot"),
            (cargo, "cargo"),
            (pads, "pad"),
            (self._regions, "region"),
            (self._spots, "spot"),
        )
        declarations = "\n  ".join(
            f"{' '.join(n)} - {kind}" for n, kind in objects if n
        )
        facts = "\n  ".join((*self._lies(), *self._reach()))
        goals = " ".join(f"(on {top} {bottom})" for top, bottom in self._goal.pairs)
        return (
            f"(define (problem {name})\n (:domain {DOMAIN})\n"
            f" (:objects\n  {declarations})\n (:init\n  {facts})\n"
            f" (:goal (and {goals}))\n (:metric minimize (total-time)))\n"
        )

    def _lies(self) -> list[str]:
        """Return the facts about positions of robots and objects."""
        found = [f"(free {robot})" for robot in self._grounder.robots]
        for name in self._things:
            below = self._now.supports.get(name, TABLE)
            if name in self._now.supports:
                where = f"spot_{name}" if below == TABLE else below
                found.append(f"(on {name} {where})")
            lowest = name
            while self._now.supports.get(lowest, TABLE) != TABLE:
                lowest = self._now.supports[lowest]
            found.append(f"(at {name} spot_{lowest})")
            if self._now.on_top_of(name) is None:
                found.append(f"(clear {name})")
        return found

    def _reach(self) -> list[str]:
        """Return the facts about reach and durations."""
        found = []
        for number, robot in enumerate(self._grounder.robots):
            regions = self._now.spec.regions
            near = {
                name: pose
                for name, pose in self._spots.items()
                if self._grounder.reaches(robot, pose)
            } | {n: p for n, p in self._regions.items() if number in regions[n]}
            for place, pose in near.items():
                home_s = (1.0 - PLACED) * self._grounder.duration_s(robot, pose, pose)
                found.append(f"(reaches {robot} {place})")
                found.append(f"(= (home-time {robot} {place}) {home_s:.2f})")
                for other, end in near.items():
                    bring_s = PLACED * self._grounder.duration_s(robot, pose, end)
                    found.append(
                        f"(= (bring-time {robot} {place} {other}) {bring_s:.2f})"
                    )
        return found
