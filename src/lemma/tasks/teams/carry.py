"""The family *carry*: a tray that two robots lift onto a rack, with its load on it.

The robots stand so far apart that each reaches one handle of the tray, where it lies
and where it shall lie, and could not touch the other handle.
"""

import math
from dataclasses import replace

import numpy as np

from lemma.core.poses import FloatArray, Pose2
from lemma.robots.reach import reach_of
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.tray import RACK, TRAY, TRAY_LENGTH_M
from lemma.tasks.goal import Goal, On
from lemma.tasks.library import task
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.task import TEAMS
from lemma.tasks.teams.coalitions import handles_beyond
from lemma.tasks.zones import INSIDE_M, Mask, Zone

_APART_M = 0.15
"""Between the axes of the tray and racks, at least."""
_LOAD_M = 0.10
"""The load begins no farther from the middle of the tray than this, along it."""
_KINDS = (TRAY.name, RACK.name)
_STEPS = 9
_ROUNDED_M = 2e-4
"""Places are rounded after they were drawn."""


@task(
    "carry",
    "Two robots carry a tray with a cube on it to a rack, each by one handle.",
    subtasks=1,
    distractors=(0, 3),
    layout="wide_pair",
    kinds=("tray", "rack"),
    teams=TEAMS,
)
def arrange_carry(placer: ObjectPlacer) -> Goal:
    """Each robot reaches one end of the tray and of both racks."""
    zone = _between(placer)
    rack = placer.put("rack", zone)
    placer.put("rack", zone)
    tray = placer.put("tray", zone)
    load = placer.cube(_on_tray(placer.objects[-1].pose))
    return Goal((On(tray, rack), On(load, tray)))


def _between(placer: ObjectPlacer) -> Zone:
    """Where each of two robots has one end, and could not touch the other one."""
    robots, half_m = placer.robots, TRAY_LENGTH_M / 2

    def sift(kind: ObjectKind, x: FloatArray, y: FloatArray) -> Mask:
        del kind
        found = np.ones(len(x), np.bool_)
        for number, robot in enumerate(robots):
            far_m = reach_of(robot.arm).travel_m - INSIDE_M + half_m
            found &= placer.territory.distance(number, x, y) < far_m
        return found

    def check(pose: Pose2) -> bool:
        there = [o.pose for o in placer.objects if o.kind in _KINDS]
        apart = all(_apart_m(pose, other) >= _APART_M for other in there)
        return apart and _has_an_end_each(placer, pose)

    says = "where each robot works at one end and could not touch the other one"
    return Zone(sift, check, says=f"{says}, beside the tray and the racks")


def _on_tray(tray: Pose2) -> Zone:
    """Where the load begins: along the middle of the tray, at any heading."""

    def draw(rng: np.random.Generator) -> Pose2:
        turn = rng.uniform(-math.pi, math.pi)
        return tray @ Pose2(rng.uniform(-_LOAD_M, _LOAD_M), 0.0, turn)

    def check(pose: Pose2) -> bool:
        at = tray.inverse() @ pose
        return abs(at.x) <= _LOAD_M + _ROUNDED_M and abs(at.y) <= _ROUNDED_M

    return replace(Zone.where(check), draw=draw, says="on the middle of the tray")


def _has_an_end_each(placer: ObjectPlacer, pose: Pose2) -> bool:
    """Whether one robot surely works at either handle, and could not at the other."""
    assert TRAY.carried is not None
    near = [pose @ grasp.at for grasp in TRAY.carried.handles]
    x, y = (np.array([getattr(at, axis) for at in near]) for axis in ("x", "y"))
    for first in (0, 1):
        works = all(
            placer.territory.works(robot, x, y)[(first + robot) % 2]
            for robot in range(2)
        )
        beyond = all(
            handles_beyond(placer.territory, robot, TRAY, pose)
            == {(first + robot + 1) % 2}
            for robot in range(2)
        )
        if works and beyond:
            return True
    return False


def _apart_m(one: Pose2, other: Pose2) -> float:
    """Return how far the axes of two trays are from each other [m]."""
    reach_m = TRAY_LENGTH_M / 2
    ways = [reach_m * (2.0 * k / (_STEPS - 1) - 1.0) for k in range(_STEPS)]
    return min(
        min(_to_axis_m(one, other @ Pose2(u, 0.0)) for u in ways),
        min(_to_axis_m(other, one @ Pose2(u, 0.0)) for u in ways),
    )


def _to_axis_m(pose: Pose2, point: Pose2) -> float:
    local = pose.inverse() @ point
    along = max(0.0, abs(local.x) - TRAY_LENGTH_M / 2)
    return math.hypot(along, local.y)
