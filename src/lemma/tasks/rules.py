"""Checks whether the sampler could have produced an instance that a user changed.

The task's ``arrange`` runs again with a placer that returns the present objects. The
instance does not record which object has which role, so all assignments that lead to
its goal are tried.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, permutations, product

import numpy as np

from lemma.core.errors import LemmaError
from lemma.core.poses import wrap
from lemma.core.seeding import stream
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.reach import reach_of
from lemma.scene.spec import ObjectPlacement
from lemma.scene.table import Gap
from lemma.tasks.drags import LARGEST_HEADING_RAD, heading_from
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.placement import ObjectPlacer, PlacementError
from lemma.tasks.task import TASKS, Task
from lemma.tasks.teams.layouts import (
    APART_M,
    LATERAL_M,
    LAYOUTS,
    PAIR,
    SHARED_WIDTH_M,
    YAW_RAD,
    apart_m,
    gap_beyond,
)
from lemma.tasks.zones import FROM_EDGE_M, Zone, ZoneLike, beside_base_m, gap_m

_ROUNDED_M = 1e-4
_AROUND = _ROUNDED_M * np.array(list(product((0.0, -1.0, 1.0), repeat=2)))
"""Offsets of a position before the sampler rounded it, (9, 2) [m]."""
_MIDDLE_M = 0.02
_MOST_WAYS = 5000


def problems(instance: Instance) -> tuple[str, ...]:
    """Return sentences about all violations of the sampler's conditions.

    Args:
        instance: An instance of a registered task.

    Returns:
        The sentences; empty if the sampler could have produced the instance.

    Raises:
        UnknownNameError: There is no such task.
    """
    task = TASKS[instance.task]
    layout, robots = LAYOUTS[task.layout], len(instance.scene.robots)
    if robots != layout.size:
        return (
            f"The sampler sets tables of {task.name} for {layout.size} robots, and "
            f"this one has {robots}.",
        )
    crowded = tuple(_crowded(instance))
    found: tuple[str, ...] | None = None
    for placer, goal in _ways(instance, task):
        faults = (*_stands(instance, task, placer.order), *placer.judge(goal))
        if found is None or len(faults) < len(found):
            found = faults
        if not found:
            break
    if found is None:
        found = (f"The goal is none that the task {task.name} sets on such a table.",)
    return tuple(dict.fromkeys((*crowded, *found)))


class _RecordedPlacer(ObjectPlacer):
    """A placer that returns the objects of an instance instead of sampling."""

    def __init__(
        self,
        instance: Instance,
        order: tuple[int, ...],
        there: tuple[ObjectPlacement, ...],
        choices: tuple[int, ...] = (),
    ) -> None:
        super().__init__(
            instance.scene.robots, stream("rules"), order, instance.scene.gap_m
        )
        self.rule = rule.kind if (rule := instance.goal.rule) else ""
        self.choices = list(choices)
        """Results of :meth:`choose`, in order."""
        self.counts: list[int] = []
        """The number of possibilities of each."""
        self._left = list(there)
        self._asked: list[tuple[ObjectPlacement, Zone, int]] = []
        self._stick_of: int | None = None
        self._robots = robot_phrases(instance.scene.robots)

    def choose(self, count: int) -> int:
        """Return the next choice; the first possibility where none is given."""
        self.counts.append(count)
        if len(self.choices) < len(self.counts):
            self.choices.append(0)
        return self.choices[len(self.counts) - 1]

    def others(self, given: int) -> Iterator[tuple[int, ...]]:
        """Yield the choices that differ from these in one that was not given."""
        for at in range(given, len(self.counts)):
            for other in range(1, self.counts[at]):
                yield (*self.choices[:at], other)

    def put(
        self,
        kind: str,
        zone: ZoneLike,
        color: str | None = None,
        mass_kg: float | None = None,
    ) -> str:
        """Return the next object of a kind and a mass."""
        placed = self._take(kind, color, mass_kg)
        wanted = zone if isinstance(zone, Zone) else Zone.where(zone)
        self._asked.append((placed, wanted, len(self.objects)))
        self.objects.append(placed)
        self._zones[placed.name] = wanted
        return placed.name

    def stick(self, robot: int) -> str:
        """Return the stick."""
        placed = self._take("stick", None, None)
        self._stick_of = robot
        self.objects.append(placed)
        return placed.name

    def _take(
        self, kind: str, color: str | None, mass_kg: float | None
    ) -> ObjectPlacement:
        for placed in self._left:
            alike = placed.kind == kind and placed.mass_kg == mass_kg
            if alike and color in (None, placed.color):
                self._left.remove(placed)
                return placed
        raise PlacementError(kind)

    def judge(self, goal: Goal) -> tuple[str, ...]:
        """Return sentences about objects in wrong places."""
        everything, bad = self.objects, []
        for placed, zone, before in self._asked:
            self.objects = everything[:before]
            fault = self._wrong(placed, zone)
            bad += [fault] if fault else []
        self.objects = everything
        if self._stick_of is not None:
            bad += self._wrong_stick(self._stick_of)
        if not bad:
            try:
                self.check(goal)
            except PlacementError as error:
                bad.append(_hindered(str(error)))
        return tuple(bad)

    def _wrong(self, placed: ObjectPlacement, zone: Zone) -> str:
        kind, name = placed.entity.kind, placed.entity.phrase
        x, y = placed.pose.x + _AROUND[:, 0], placed.pose.y + _AROUND[:, 1]
        if not self.territory.on_table(x, y, kind.disc_m + FROM_EDGE_M).any():
            return f"The {name} does not lie completely on the table."
        if not self.territory.in_view(x, y).any():
            return f"The {name} lies where no robot's camera sees it."
        checked = zone.check is None or zone.check(placed.pose)
        if zone.sift(kind, x, y).any() and checked:
            return ""
        says = zone.says.format(*self._robots) or "where the task wants it"
        return f"The {name} must lie {says}. Now {self._situation(placed)}."

    def _situation(self, placed: ObjectPlacement) -> str:
        """Return a phrase about the robots' reach of an object."""
        x, y = np.array([placed.pose.x]), np.array([placed.pose.y])
        phrases = []
        for robot, phrase in enumerate(self._robots):
            if self.territory.works(robot, x, y)[0]:
                what = "works there"
            elif self.territory.cannot(robot, placed.entity.kind, x, y)[0]:
                what = "could not touch it"
            else:
                what = "might touch it, but does not reach it with a margin"
            phrases.append(f"the {phrase} {what}")
        return " and ".join(phrases)

    def _wrong_stick(self, robot: int) -> list[str]:
        (placed,) = (p for p in self.objects if p.kind == "stick")
        pose, phrase = placed.pose, self._robots[robot]
        yaw = np.full(len(_AROUND), pose.yaw)
        x, y = pose.x + _AROUND[:, 0], pose.y + _AROUND[:, 1]
        bad = []
        if not self.suits_stick(robot, x, y, yaw).any():
            bad.append(
                f"All of the stick must lie on the table and in view, where the "
                f"{phrase} grasps it and no other robot could touch it."
            )
        turned = heading_from(self.robots[robot].base, pose)
        if turned > LARGEST_HEADING_RAD + 1e-3:
            bad.append(
                f"The stick must point away from the {phrase}: it is turned by "
                f"{math.degrees(turned):.0f} degrees, and may be by "
                f"{math.degrees(LARGEST_HEADING_RAD):.0f}."
            )
        return bad


def _ways(instance: Instance, task: Task) -> Iterator[tuple[_RecordedPlacer, Goal]]:
    """Yield all assignments of an instance's objects to the roles of a task."""
    by_kind: dict[str, list[ObjectPlacement]] = {}
    extra = [p for p in instance.scene.objects if p.name in instance.distractors]
    for placed in instance.scene.objects:
        if placed not in extra:
            by_kind.setdefault(placed.kind, []).append(placed)
    there_are = [robot.hand for robot in instance.scene.robots]
    for order in LAYOUTS[task.layout].orders:
        if there_are != task.hands_of(order):
            continue
        every = product(*map(permutations, by_kind.values()))
        for chosen in islice(every, _MOST_WAYS):
            there = tuple(placed for kind in chosen for placed in kind)
            ways: list[tuple[int, ...]] = [()]
            while ways:
                choices = ways.pop()
                placer = _RecordedPlacer(instance, order, (*there, *extra), choices)
                goal = _arranged(placer, task, extra)
                ways += placer.others(len(choices))
                if goal and set(goal.pairs) == set(instance.goal.pairs):
                    yield placer, replace(goal, rule=instance.goal.rule)


def _arranged(
    placer: _RecordedPlacer, task: Task, extra: Sequence[ObjectPlacement]
) -> Goal | None:
    """Return the goal that a task sets with what lies there; None if it cannot."""
    try:
        goal = task.arrange(placer)
        for placed in extra:
            placer.put(placed.kind, placer.anywhere(), placed.color, placed.mass_kg)
    except (LemmaError, PlacementError):
        return None
    return goal


def _crowded(instance: Instance) -> Iterator[str]:
    """Yield sentences about objects that are too close to others."""
    robots, phrases = instance.scene.robots, robot_phrases(instance.scene.robots)
    # An object on a tray is above all others.
    objects = [o for o in instance.scene.objects if not instance.scene.rests_m(o)]
    for i, one in enumerate(objects):
        for other in objects[i + 1 :]:
            kind, near = one.entity.kind, other.entity.kind
            least, gap = kind.spacing_to(near), gap_m(kind, one.pose, near, other.pose)
            if gap < least - _ROUNDED_M:
                yield (
                    f"The {one.entity.phrase} and the {other.entity.phrase} are "
                    f"{100 * gap:.0f} cm apart, and need {100 * least:.0f} cm."
                )
        for robot, phrase in zip(robots, phrases, strict=True):
            away = gap_m(one.entity.kind, one.pose, None, robot.base)
            beside_m = beside_base_m(one.entity.kind)
            if away < sweep_radius_m(robot.arm) + beside_m - _ROUNDED_M:
                yield f"The {one.entity.phrase} lies at the {phrase}'s base."


def _stands(instance: Instance, task: Task, order: tuple[int, ...]) -> Iterator[str]:
    """Yield sentences about robots in wrong places."""
    robots, phrases = instance.scene.robots, robot_phrases(instance.scene.robots)
    if task.layout != PAIR:
        if not LAYOUTS[task.layout].allows(robots):
            yield f"The robots do not stand as in the layout {task.layout}."
        split = LAYOUTS[task.layout].split
        at = split(robots) if split is not None else None
        if not _is_same_gap(at, instance.scene.gap_m):
            yield f"The gap in the table is not as in the layout {task.layout}."
        return
    for number, (robot, phrase) in enumerate(zip(robots, phrases, strict=True)):
        turned = wrap(robot.base.yaw - math.pi * number)
        if abs(robot.base.y) > LATERAL_M or abs(turned) > YAW_RAD + 1e-3:
            yield (
                f"The {phrase} does not stand as the sampler has it: within "
                f"{100 * LATERAL_M:.0f} cm of the middle line, and turned to the other "
                f"within {math.degrees(YAW_RAD):.0f} degrees."
            )
    team = tuple(robot.arm for robot in robots)
    left, right = robots[0].base.x, robots[1].base.x
    first, second = (reach_of(arm).travel_m for arm in team)
    if task.apart:
        least, most = (apart_m(team, order) + more for more in APART_M)
    else:
        least, most = (first + second - width for width in reversed(SHARED_WIDTH_M))
    if not least - _ROUNDED_M <= right - left <= most + _ROUNDED_M:
        yield (
            f"The robots stand {right - left:.2f} m apart, and the sampler has them "
            f"{least:.2f} to {most:.2f} m apart."
        )
    elif abs(left + right + first - second) / 2.0 > _MIDDLE_M:
        yield "The robots do not meet in the middle of the table."
    wanted = gap_beyond(robots, order[0]) if task.apart else None
    if not _is_same_gap(wanted, instance.scene.gap_m):
        yield f"The gap in the table is not where the {phrases[order[0]]} needs it."


def _is_same_gap(wanted: Gap | None, there: Gap | None) -> bool:
    if wanted is None or there is None:
        return wanted is there
    return all(
        abs(one - other) <= 2 * _ROUNDED_M
        for one, other in zip(wanted, there, strict=True)
    )


def _hindered(what: str) -> str:
    """Return a sentence about a :class:`PlacementError` of the whole instance."""
    primitive, _, name = what.partition(" ")
    if primitive == "team":
        return "The team might reach the goal without one of its robots."
    if primitive == "robot":
        return "One robot alone might push a tower of cubes to where the goal wants it."
    return (
        f"The {name.replace('_', ' ')} cannot be dragged by the stick as the task "
        f"needs it ({primitive}): something is in the way."
    )
