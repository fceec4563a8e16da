"""Stages: progress of an episode, measured by physics alone.

Each sub-task of the expert's plan for the instance has five stages:

1. *approached*: the hand of an able robot is near the grasp pose of the object,
2. *touched*: it touches the object,
3. *grasped*: both fingers touch the object,
4. *lifted*: the grasped object is off the table or has moved; or *dragged*: the stick
   is held, and the cube has moved,
5. *placed*: the moved object rests at its place in the sub-task, and no robot leads it.

Of ``carry`` each counts once both robots have come so far, each at its handle; of
``give`` once either has, whoever holds the thing.
``reach`` has two, approached and placed: the hand is over the object. ``lift`` has
four: approached, touched, grasped and lifted.

``progress`` is the fraction of the stages of all sub-tasks that are reached *in order
and not undone*: the stages of a sub-task count once the earlier sub-tasks with the same
objects are done, and stages no longer count after an object is dropped, knocked away or
taken back. It is 1 if the goal holds. It does not depend on the policy or the level.

A robot is *able* if it reaches the picked entity and, if that is an object, its place.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from itertools import product
from typing import Any
from weakref import proxy

import numpy as np

from lemma.core.poses import Pose2
from lemma.env.signals.stage_events import (
    LIFT_M,
    MOVED_M,
    NEAR_M,
    EventState,
    StageEvents,
)
from lemma.env.simulation import Simulation
from lemma.planning.grounding import GeometricGrounder
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.objects.contacts import (
    LEFT,
    RIGHT,
    find_touches,
    is_near_or_moved,
    watched_m,
)
from lemma.scene.objects.entity import STICK, kind_of
from lemma.tasks.drags import grasp_on_stick
from lemma.tasks.goal import Goal, Lifted, On, Predicate, Reached, is_at_rest
from lemma.tasks.subtask import JOINT, Primitive, SubTask

LOOK_TICKS = 5
"""Servo ticks between two updates: 50 ms."""

_PREPARES = {Primitive.PREHOOK: Primitive.HOOK, Primitive.PREPOKE: Primitive.POKE}
_DRAGS = tuple(_PREPARES.values())
_HANDS: dict[Primitive, Callable[[str], Predicate]] = {
    Primitive.REACH: Reached,
    Primitive.LIFT: Lifted,
}


class Stage(StrEnum):
    """A physical milestone of a sub-task."""

    APPROACHED = "approached"
    TOUCHED = "touched"
    GRASPED = "grasped"
    LIFTED = "lifted"
    DRAGGED = "dragged"
    """Replaces ``LIFTED`` if the stick moves a cube."""
    PLACED = "placed"


_LADDER = (Stage.APPROACHED, Stage.TOUCHED, Stage.GRASPED, Stage.LIFTED, Stage.PLACED)
_DRAGGED = tuple(Stage.DRAGGED if s is Stage.LIFTED else s for s in _LADDER)


def stages_of(primitive: Primitive) -> tuple[Stage, ...]:
    """Return the stages of a sub-task in order; the last one completes it."""
    if primitive is Primitive.REACH:
        return (Stage.APPROACHED, Stage.PLACED)
    if primitive is Primitive.LIFT:
        return _LADDER[:4]
    return _DRAGGED if primitive in _DRAGS else _LADDER


@dataclass(frozen=True, slots=True)
class Furthest:
    """The furthest progress in an episode."""

    progress: float = 0.0
    """Fraction of the stages, in [0, 1]."""
    subtask: int | None = None
    """Index in the plan of the last sub-task with a reached stage."""
    stage: str = ""
    """That stage; empty if there was none."""
    time_s: float = 0.0
    """Simulated time at which it was reached [s]."""


@dataclass(frozen=True, slots=True)
class FirstMove:
    """The first object that a robot moved, and the verdicts on this move."""

    entity: str
    robot: str
    understood: bool | None = None
    """Whether the object belongs to the goal and went to its place; None during the
    move."""
    allocated: bool = False
    """Whether an able robot moved it."""
    executed: bool | None = None
    """Whether the sub-task was completed: the object rests at its place in the plan."""


@dataclass(frozen=True, slots=True)
class StageState:
    """The state of a :class:`StageWatch`; plain data."""

    ticks: int
    near: bool
    seen: tuple[float, ...]
    events: EventState | None
    stood: tuple[bool, ...] | None
    progress: float
    furthest: Furthest
    first: FirstMove | None


class StageWatch:
    """Follows an episode through the stages of the expert's plan."""

    def __init__(self, simulation: Simulation, goal: Goal) -> None:
        """Start in the first state of an episode, and observe the simulation."""
        # The simulation refers to this watch. A weak proxy avoids a reference cycle,
        # which would keep the engine's memory until garbage collection.
        self._simulation: Simulation = proxy(simulation)
        self._goal = goal
        self._scene = simulation.scene
        self._start = SymbolicState.observe(self._scene)
        self._grounder = GeometricGrounder(self._scene.spec)
        coasting = simulation.scene.coasting
        self._names = coasting.names
        self._number = {name: k for k, name in enumerate(coasting.names)}
        self._at = coasting.qpos_at
        self._seen = np.array([self._scene.data.qpos[at : at + 3] for at in self._at])
        self._seen = self._seen.reshape(-1, 3)
        self._first_seen = self._seen.copy()
        self._watch_m = watched_m(self._names)
        robots = len(self._scene.robots)
        self._sites, self._parts = self._scene.tcp_sites, self._scene.parts
        self._touch = np.zeros((robots, len(self._names)), np.int64)
        self._led = np.zeros(len(self._names), np.bool_)
        self._ticks, self._near = 0, False
        self._stood: list[bool] | None = None
        self.progress = 1.0 if self._holds() else 0.0
        """Fraction of the stages that are reached in order and not undone, in [0,
        1]."""
        self.furthest = Furthest(self.progress)
        """The furthest progress so far."""
        self.first: FirstMove | None = None
        """The first object that was moved; None before."""
        simulation.watch = self

    @cached_property
    def plan(self) -> tuple[SubTask, ...]:
        """The expert's plan for the instance; empty where there is none."""
        found = find_plan(self._start, self._goal, self._grounder)
        return () if found is None else found.subtasks

    @cached_property
    def _too_heavy(self) -> frozenset[tuple[str, str]]:
        """The robots and objects that are too heavy for them."""
        spec = self._scene.spec
        pairs = product(spec.robot_names, spec.object_names)
        return frozenset(pair for pair in pairs if self._grounder.overload(*pair))

    @cached_property
    def _events(self) -> StageEvents:
        return StageEvents(self._scene, self._goal, self.plan, self._first_seen)

    def record(self) -> dict[str, Any]:
        """Return the furthest stage and the verdicts, ready for JSON.

        Returns:
            ``progress``, ``subtask``, ``stage`` and ``time_s`` of the furthest
            progress; ``moved``, the first object that a robot moved, and ``by``, the
            robot; and the verdicts ``understood``, ``allocated`` and ``executed`` on
            that move, None if there was none or it did not end.
        """
        most, first = self.furthest, self.first
        return {
            "progress": most.progress,
            "subtask": most.subtask,
            "stage": str(most.stage),
            "time_s": round(most.time_s, 3),
            "moved": "" if first is None else first.entity,
            "by": "" if first is None else first.robot,
            "understood": None if first is None else first.understood,
            "allocated": None if first is None else first.allocated,
            "executed": None if first is None else first.executed,
        }

    def state(self) -> StageState:
        """Return the present state of this watch."""
        stood = None if self._stood is None else tuple(self._stood)
        seen = tuple(self._seen.ravel().tolist())
        looked = "_events" in self.__dict__
        events = self._events.state() if looked else None
        watched = (self._ticks, self._near, seen, events, stood)
        return StageState(*watched, self.progress, self.furthest, self.first)

    def restore(self, state: StageState) -> None:
        """Restore an earlier state of this watch."""
        self._ticks, self._near, self.progress = state.ticks, state.near, state.progress
        self._seen[:] = np.reshape(state.seen, self._seen.shape)
        self.__dict__.pop("_events", None)
        if state.events is not None:
            self._events.restore(state.events)
        self._stood = None if state.stood is None else list(state.stood)
        self.furthest, self.first = state.furthest, state.first

    @property
    def due_ticks(self) -> int:
        """Number of servo ticks until the next update."""
        return LOOK_TICKS - self._ticks % LOOK_TICKS

    def look(self, ticks: int) -> None:
        """Count servo ticks, and update from the present state if it is time."""
        simulation, data = self._simulation, self._scene.data
        self._ticks += ticks
        if self._ticks % LOOK_TICKS:
            return
        near, moved = is_near_or_moved(
            *(data.qpos, self._at, data.site_xpos, self._sites),
            *(self._seen, self._watch_m),
        )
        if not (near or moved or self._near):
            return
        self._near = near
        if not self._events.look():
            return
        self._touch[:] = 0
        self._led = self._scene.coasting.led()
        find_touches(
            data.contact.geom, simulation.scene.coasting.owner, self._parts, self._touch
        )
        self._follow_first_move()
        progress, step, stage = self._progress()
        self.progress = progress
        if progress > self.furthest.progress + 1e-9:
            self.furthest = Furthest(progress, step, stage, simulation.time_s)

    def _holds(self) -> bool:
        return self._goal.progress(self._scene) == 1.0

    def _progress(self) -> tuple[float, int | None, str]:
        """Return the present progress, and its last sub-task and stage."""
        plan = self.plan
        if not plan:
            share = self._goal.progress(self._scene)
            return share, None, Stage.PLACED if share else ""
        levels = [self._level(step) for step in plan]
        stood = self._stood or [False] * len(plan)
        for i in reversed(range(len(plan))):
            stood[i] = self._is_placed(plan, i) or (
                stood[i] and not self._is_undone(plan, i, stood, levels)
            )
        self._stood = stood
        reached, last, stage = 0, None, ""
        for i, step in enumerate(plan):
            if not all(stood[k] for k in self._before(plan, i)):
                continue
            steps = stages_of(step.primitive)
            level = len(steps) if stood[i] else min(levels[i], len(steps) - 1)
            reached += level
            if level:
                last, stage = i, steps[level - 1]
        if self._holds():
            return 1.0, len(plan) - 1, stages_of(plan[-1].primitive)[-1]
        # Progress stays below 1 until the goal holds, even if the plan is done.
        total = len([s for step in plan for s in stages_of(step.primitive)])
        return min(reached, total - 1) / total, last, stage

    def _before(self, plan: tuple[SubTask, ...], i: int) -> Iterator[int]:
        """Yield the earlier sub-tasks with the same objects; pads do not count."""
        mine = {name for name in _entities(plan[i]) if name in self._number}
        if kind_of(plan[i].pick).span_m is not None:
            # Earlier ones may have brought its second support.
            return iter(range(i))
        return (k for k in range(i) if mine & {*_entities(plan[k])})

    def _level(self, step: SubTask) -> int:
        """Return how many of the first four stages of a sub-task hold now."""
        if step.pick not in self._number:
            return 0
        item, levels = self._number[step.pick], [0]
        for robot, name in enumerate(self._scene.spec.robot_names):
            touch, level = int(self._touch[robot, item]), 0
            grasped = touch & LEFT and touch & RIGHT
            if not self._is_able(name, step, held=bool(grasped)):
                continue
            if grasped:
                subject = self._number[_subject(step)]
                moved = self._way_m(subject) > MOVED_M or (
                    subject == item and self._rise_m(item) > LIFT_M
                )
                level = 4 if moved else 3
            elif touch:
                level = 2
            elif self._hand_m(robot, step.pick) < NEAR_M:
                level = 1
            levels.append(level)
        # Of what two robots carry, as far as both are.
        hands = 2 if step.primitive is Primitive.CARRY else 1
        return sorted(levels)[-hands] if len(levels) >= hands else 0

    def _is_able(self, robot: str, step: SubTask, *, held: bool) -> bool:
        """Return True if a robot reaches pick and place, and carries the pick."""
        reaches = self._grounder.reaches
        if step.primitive not in JOINT and (robot, step.pick) in self._too_heavy:
            return False
        if not held and not reaches(robot, self._grip(step.pick, robot)):
            return False
        if step.primitive is Primitive.GIVE:
            return True
        if step.place in self._scene.object_names and step.pick != STICK:
            place = self._scene.pose2(step.place)
            return reaches(robot, self._handle(step.pick, robot, place))
        return True

    def _grip(self, name: str, robot: str = "") -> Pose2:
        """Return the grasp pose of an object: for a robot, if there are two."""
        pose = self._scene.pose2(name)
        if name == STICK:
            return grasp_on_stick(pose)
        return self._handle(name, robot, pose) if robot else pose

    def _handle(self, name: str, robot: str, at: Pose2) -> Pose2:
        """Return where a robot has its hand when an object lies somewhere."""
        handles = kind_of(name).handles
        if handles is None:
            return at
        base = self._grounder.robots[robot].base
        return min((at @ grasp.at for grasp in handles), key=base.distance)

    def _hand_m(self, robot: int, name: str) -> float:
        """Return the distance of a hand from an object's grasp position [m]."""
        x, y, z = self._scene.data.site_xpos[self._sites[robot]].tolist()
        hand = self._scene.spec.robot_names[robot]
        grip, height = self._grip(name, hand), self._scene.position(name)[2]
        return float(np.sqrt((x - grip.x) ** 2 + (y - grip.y) ** 2 + (z - height) ** 2))

    def _rise_m(self, item: int) -> float:
        at = self._at[item]
        return float(self._scene.data.qpos[at + 2] - self._first_seen[item, 2])

    def _way_m(self, item: int) -> float:
        at = self._at[item]
        off = self._scene.data.qpos[at : at + 3] - self._first_seen[item]
        return float(np.sqrt(off @ off))

    def _rests(self, name: str) -> bool:
        """Whether no robot leads an object, and it neither moves nor turns."""
        led = self._led[self._number[name]]
        return not led and is_at_rest(self._scene, name)

    def _is_placed(self, plan: tuple[SubTask, ...], i: int) -> bool:
        """Return True if the object that a sub-task moves rests at its place."""
        step = plan[i]
        if step.primitive in _PREPARES:
            now = SymbolicState.observe(self._scene)
            return (
                {STICK, step.place} <= set(now.poses)
                and now.is_prepared(_PREPARES[step.primitive], step.place)
                and self._rests(STICK)
            )
        if step.primitive in _HANDS:
            return _HANDS[step.primitive](step.pick).holds(self._scene)
        subject = _subject(step)
        if subject not in self._number:
            return False
        if step.primitive not in _DRAGS and step.place in self._scene.object_names:
            return On(step.pick, step.place).holds(self._scene)
        if subject in self._scene.fallen or not self._rests(subject):
            return False
        wanted = _next_robots(plan, i) or self._scene.spec.robot_names
        grip = self._grip(subject)
        return any(self._grounder.reaches(robot, grip) for robot in wanted)

    def _is_undone(
        self, plan: tuple[SubTask, ...], i: int, stood: list[bool], levels: list[int]
    ) -> bool:
        """Whether the effect of a sub-task is gone, and no later one has begun."""
        subject = _subject(plan[i])
        if subject not in self._scene.fallen and not self._rests(subject):
            return False
        later = (k for k in range(i + 1, len(plan)) if subject in _entities(plan[k]))
        return not any(stood[k] or levels[k] >= 2 for k in later)

    def _follow_first_move(self) -> None:
        """Find the first moved object, and judge the move when it comes to rest."""
        if self.first is None:
            for item, name in enumerate(self._names):
                if self._led[item] and self._way_m(item) > MOVED_M:
                    robot = self._leader(name)
                    if robot is not None:
                        mine = [s for s in self.plan if _subject(s) == name]
                        able = any(step.robot == robot for step in mine)
                        self.first = FirstMove(name, robot, allocated=able)
                    return
        elif self.first.understood is None:
            name = self.first.entity
            if not self._rests(name) and name not in self._goal.held:
                return
            done = any(
                _subject(step) == name and self._is_placed(self.plan, i)
                for i, step in enumerate(self.plan)
            )
            if done or self._rests(name):
                right = done or self._belongs(name)
                self.first = replace(self.first, understood=right, executed=done)

    def _leader(self, name: str) -> str | None:
        """Return the robot that touches an object, or the stick if none does."""
        for item in (name, STICK):
            if item in self._number:
                touch = self._touch[:, self._number[item]]
                if touch.any():
                    return self._scene.spec.robot_names[int(np.argmax(touch))]
        return None

    def _belongs(self, name: str) -> bool:
        """Return True if an object of the goal lies where another robot can take it."""
        if name not in {entity for step in self.plan for entity in _entities(step)}:
            return False
        now = SymbolicState.observe(self._scene)
        if now.supports.get(name, "table") != "table" or name in now.fallen:
            return False
        before, after = (
            {r for r in self._grounder.robots if self._grounder.reaches(r, pose)}
            for pose in (self._start.poses[name], self._grip(name))
        )
        return bool(after - before)


def _subject(step: SubTask) -> str:
    """Return the object that a sub-task moves: the dragged cube, or the pick."""
    return step.place if step.primitive in _DRAGS else step.pick


def _entities(step: SubTask) -> tuple[str, str]:
    return (step.pick, step.place)


def _next_robots(plan: tuple[SubTask, ...], i: int) -> tuple[str, ...]:
    """Return the robot that handles the object of a sub-task next."""
    subject = _subject(plan[i])
    later = (step for step in plan[i + 1 :] if subject in _entities(step))
    return tuple(step.robot for step in later)[:1]
