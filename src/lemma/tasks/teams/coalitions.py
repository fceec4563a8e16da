"""The robots that a goal needs: what a team could do without one, by geometry.

If no team without one robot could reach a goal, no smaller coalition could either. A
coalition is kept from ``On(top, bottom)`` where none of it could touch the top, none
could touch the bottom or put anything on it, or nothing could get from those who could
do the one to those who could do the other. All of that is said of what robots *could*
do (:mod:`lemma.robots.could`), with whatever they can touch as a means: a row of cubes
that is pushed gets farther than a hand, and so does a bar that is held by its end. A
robot for which a top is too heavy could not get it onto something as high as the top
itself, unless there is a lower rim.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lemma.core.poses import Pose2
from lemma.core.robot_names import robot_name
from lemma.core.seeding import ordered_sum
from lemma.scene.objects.entity import entity_named, is_carried
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.spec import ObjectPlacement
from lemma.tasks.goal import Goal, On
from lemma.tasks.zones import OUTSIDE_M, REMOTE_M, SLIDE_M, Territory

HANDLE_DISC_M = 0.07
"""Radius of a disc around where a handle is grasped that covers all of it."""


def needed(
    territory: Territory, objects: Sequence[ObjectPlacement], goal: Goal
) -> tuple[int, ...]:
    """Return the robots without whom the others could not reach a goal.

    A robot that a rule excludes is none of them, and none of the others.

    Args:
        territory: Reach of the team.
        objects: Everything on the table.
        goal: The goal, of things that lie on others.
    """
    team = _free_to_act(territory, goal)
    return tuple(
        absent
        for absent in team
        if not _Coalition(territory, objects, set(team) - {absent}).could(goal)
    )


@dataclass(frozen=True, slots=True)
class Lack:
    """Reason why a team cannot reach a part of a goal, whatever it does."""

    part: On
    getters: tuple[int, ...]
    """Robots that could touch the top."""
    putters: tuple[int, ...]
    """Robots that could put something on the bottom."""
    is_too_heavy: bool = False
    """Whether the top is too heavy for every robot that could touch it otherwise."""

    @property
    def things(self) -> tuple[str, ...]:
        """Names of the objects that are out of reach, or too far apart."""
        if not self.getters:
            return (self.part.top,)
        return (
            (self.part.top, self.part.bottom) if self.putters else (self.part.bottom,)
        )

    def words(self, robots: Sequence[str]) -> str:
        """Return who lacks what, in a sentence.

        Args:
            robots: Phrases of the team.
        """
        top, bottom = (
            f"the {entity_named(name).phrase}"
            for name in (self.part.top, self.part.bottom)
        )
        if self.is_too_heavy:
            return f"No robot that reaches {top} can carry it."
        if not self.getters:
            return f"No robot reaches {top}."
        if not self.putters:
            return f"No robot reaches {bottom}."
        one, other = (
            f"the {' and the '.join(robots[r] for r in who)}"
            for who in (self.getters, self.putters)
        )
        return (
            f"Only {one} could touch {top}, only {other} {bottom}, and nothing gets "
            "from one to the other."
        )


def lack_of(
    territory: Territory, objects: Sequence[ObjectPlacement], goal: Goal
) -> Lack | None:
    """Return what keeps a team from a goal; None if nothing is known to.

    Args:
        territory: Reach of the team.
        objects: Everything on the table.
        goal: The goal, of things that lie on others.
    """
    whole = _Coalition(territory, objects, _free_to_act(territory, goal))
    return next(filter(None, map(whole.lack, goal.placements)), None)


def handles_beyond(
    territory: Territory, robot: int, kind: ObjectKind, at: Pose2
) -> set[int]:
    """Return which handles of a carried thing a robot could not touch.

    Args:
        territory: Reach of the team.
        robot: Which.
        kind: Of the thing.
        at: Where it lies.
    """
    if kind.carried is None:
        return set()
    ends = (at @ grasp.at for grasp in kind.carried.handles)
    base, could = territory.robots[robot].base, territory.could(robot)
    safe_m = could.radius_m(HANDLE_DISC_M) + OUTSIDE_M
    return {k for k, end in enumerate(ends) if base.distance(end) >= safe_m}


def _free_to_act(territory: Territory, goal: Goal) -> list[int]:
    """Return the robots of a team that the rule of a goal does not exclude."""
    excluded = goal.rule.robot if goal.rule is not None else None
    return [r for r in range(len(territory.robots)) if robot_name(r) != excluded]


def _is_bar(kind: ObjectKind) -> bool:
    """Whether a hand that holds a thing by its end gets farther by all its length."""
    return kind.span_m is not None or kind.ends is not None


class _Coalition:
    """Some robots of a team, and what they could touch as things lie."""

    def __init__(
        self,
        territory: Territory,
        objects: Sequence[ObjectPlacement],
        robots: Iterable[int],
    ) -> None:
        self._territory = territory
        self._robots = sorted(robots)
        self._placed = {placed.name: placed for placed in objects}
        self._bars_m: dict[str, float] = {}
        self._bars_m = {
            placed.name: 2.0 * placed.entity.kind.disc_m
            for placed in objects
            if _is_bar(placed.entity.kind) and self._touching(placed)
        }
        self._cargo = [
            placed
            for placed in objects
            if placed.entity.kind.cargo and self._touching(placed)
        ]

    def could(self, goal: Goal) -> bool:
        """Whether nothing keeps the coalition from any part of a goal."""
        return not any(map(self.lack, goal.placements))

    def lack(self, on: On) -> Lack | None:
        """Return what keeps the coalition from a part of a goal, if something does."""
        top, bottom = (self._placed[name] for name in (on.top, on.bottom))
        if is_carried(on.top):
            ends = (self._touching(top), self._touching(bottom))
            able = all(map(self._has_both_handles, (top, bottom), (top, top)))
            return None if able else Lack(on, tuple(ends[0]), tuple(ends[1]))
        if top.entity.kind.ends is not None and self._is_beyond_gap(top, bottom):
            return self._lack_across(on)
        row_m = self._row_m(but=(on.top, on.bottom))
        getters = self._touching(top) or self._pushing_together(top, row_m)
        # A cube that stands on one that is pushed slides or tips over where it stops.
        tower_m = row_m + 2.0 * top.entity.kind.side_m if row_m else 0.0
        putters = self._touching(bottom) + self._within(bottom, tower_m)
        raising = [r for r in getters if self._could_raise(r, top, bottom)]
        if getters and not raising:
            return Lack(on, (), (), is_too_heavy=True)
        getters = raising
        groups = self._groups(top.entity.kind, row_m)
        if any(group & set(getters) and group & set(putters) for group in groups):
            return None
        return Lack(on, tuple(sorted({*getters})), tuple(sorted({*putters})))

    def _is_beyond_gap(self, one: ObjectPlacement, other: ObjectPlacement) -> bool:
        """Whether two things lie on different table tops, and the top falls between."""
        gap = self._territory.gap_m
        if gap is None or gap[1] - gap[0] <= 2.0 * one.entity.kind.disc_m:
            return False
        return (one.pose.x <= gap[0]) != (other.pose.x <= gap[0])

    def _lack_across(self, on: On) -> Lack | None:
        """Return what keeps the coalition from a part of a goal beyond a gap.

        A thing that is pushed falls into it. A hand that holds the thing by its end has
        its middle half of its length farther out, and so has one that pushes its end.
        """
        top, bottom = (self._placed[name] for name in (on.top, on.bottom))
        getters, at = self._touching(top), bottom.pose
        x, y, by_m = np.array([at.x]), np.array([at.y]), top.entity.kind.disc_m
        putters = [
            robot
            for robot in self._robots
            if not self._territory.cannot(
                robot, bottom.entity.kind, x, y, by_m=OUTSIDE_M + by_m
            )[0]
        ]
        groups = self._groups(top.entity.kind, 0.0)
        if any(group & set(getters) and group & set(putters) for group in groups):
            return None
        return Lack(on, tuple(getters), tuple(putters))

    def _could_raise(
        self, robot: int, top: ObjectPlacement, bottom: ObjectPlacement
    ) -> bool:
        """Whether a robot that touches a thing might get it onto another.

        It carries it; or pushes it over a rim that is lower than the thing is high, of
        the other or of a pad from which it would go on.
        """
        steps = (p for p in self._placed.values() if p.entity.kind.fixed)
        rims = (bottom, *(p for p in steps if robot in self._touching(p)))
        return not self._territory.robots[robot].overload("", top) or any(
            rim.entity.kind.height_m < top.entity.kind.height_m for rim in rims
        )

    def _has_both_handles(self, at: ObjectPlacement, thing: ObjectPlacement) -> bool:
        """Whether somebody could touch either handle of a thing that lies somewhere.

        A hand at one handle does not raise the other one: the thing is as heavy as the
        fingers hold by friction against its turn.
        """
        kind, robots = thing.entity.kind, self._robots
        beyond = [handles_beyond(self._territory, r, kind, at.pose) for r in robots]
        return bool(beyond) and not set.intersection(*beyond)

    def _touching(self, placed: ObjectPlacement) -> list[int]:
        """Return who could do anything to a thing with a hand and what it holds."""
        x, y = np.array([placed.pose.x]), np.array([placed.pose.y])
        kind = placed.entity.kind
        others = (m for name, m in self._bars_m.items() if name != placed.name)
        by_m = OUTSIDE_M + max(others, default=0.0)
        return [
            robot
            for robot in self._robots
            if not self._territory.cannot(robot, kind, x, y, by_m=by_m)[0]
        ]

    def _within(self, placed: ObjectPlacement, row_m: float) -> list[int]:
        """Return who could push a row of cubes to a thing."""
        return [
            robot
            for robot in self._robots
            if row_m and not self._territory.keeps_off(robot, placed, row_m)
        ]

    def _row_m(self, but: tuple[str, ...]) -> float:
        """Return the length of a row of all cubes that the coalition could touch."""
        spare = (p.entity.kind.side_m for p in self._cargo if p.name not in but)
        return 2.0 * ordered_sum(spare)

    def _pushing_together(self, top: ObjectPlacement, row_m: float) -> list[int]:
        """Return who could touch a thing that somebody else has pushed on with a row.

        A row moves a thing away from its robot, no farther than the row reaches and the
        thing then moves on by itself.
        """
        found = []
        for pusher in self._within(top, row_m):
            base = self._territory.robots[pusher].base
            away = base.distance(top.pose)
            safe_m = self._territory.safe_m(pusher, top.entity.kind)
            far = max(away, safe_m + row_m) + REMOTE_M
            at = Pose2(
                base.x + (top.pose.x - base.x) * far / away,
                base.y + (top.pose.y - base.y) * far / away,
            )
            moved = ObjectPlacement(top.kind, top.color, at)
            found += [r for r in self._touching(moved) if r != pusher]
        return found

    def _groups(self, kind: ObjectKind, row_m: float) -> list[set[int]]:
        """Return the robots between whom a kind of thing could go from hand to hand."""
        groups: list[set[int]] = []
        for robot in self._robots:
            linked = [
                g for g in groups if any(self._linked(robot, r, kind, row_m) for r in g)
            ]
            groups = [g for g in groups if g not in linked]
            groups.append({robot}.union(*linked))
        return groups

    def _linked(self, one: int, other: int, kind: ObjectKind, row_m: float) -> bool:
        """Whether one robot could put or push a thing where another could touch it."""
        bases = [self._territory.robots[robot].base for robot in (one, other)]
        farthest = max(
            self._territory.could(giver).place_m
            + self._territory.could(taker).radius_m(kind.disc_m)
            for giver, taker in ((one, other), (other, one))
        )
        slack_m = OUTSIDE_M + row_m + SLIDE_M if row_m else REMOTE_M
        return bases[0].distance(bases[1]) < farthest + slack_m
