"""Attacks that push or shove a cube or a tower onto a bottom out of reach."""

import math
from dataclasses import replace

from lemma.audit.attack import attack
from lemma.audit.pushes import Push, overlap_m
from lemma.audit.skill.stick import (
    HOOKING,
    STRAIGHT,
    bring_within,
    carry_out,
    drag_closer,
    fixed_bottoms,
    require_stick,
    touches_by_stick,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2, wrap
from lemma.robots.gripper import FINGER_CENTER_M, FINGER_THICKNESS_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.goal import On

# Distance of a push's aim beyond the pad's middle, by attempt.
_BEYOND_M = (0.0, 0.03, 0.055)
_STAGES = 6
_TURNS_RAD = (0.0, 0.12, -0.12, 0.25, -0.25, 0.4, -0.4, 0.7, -0.7)
_INSIDE_M = (0.02, 0.06, 0.12, 0.2, 0.3)
_TOWER_PUSHES = 3
# Overhang of the upper cube towards the pad, by attempt. The upper cube tips over when
# the pad stops the lower one.
_OVERHANGS_M = (0.0, 0.015, 0.018)
# Largest distance of a grasp from a cube's middle.
_OFF_M = 0.0225
_EDGE_M = 0.0015
_FINGER_M = FINGER_CENTER_M + FINGER_THICKNESS_M / 2
_SHOVES = 7


@attack("skill", attempts=len(_BEYOND_M))
def push_onto_pad(trial: SkillTrial) -> None:
    """Hooks a cube home, sets it down in line, pushes it onto its pad."""
    _require_pads(trial)
    for on in trial.goal.placements:
        _push_on(trial, on)


@attack("skill", attempts=len(_OVERHANGS_M))
def push_tower(trial: SkillTrial) -> None:
    """Pushes a tower against the pad with the stick; its top may go on."""
    _require_pads(trial)
    spare = [name for name in trial.spare() if trial.margin(trial.pose(name)) > 0.0]
    trial.require(spare)
    for on in trial.goal.placements:
        _push_tower(trial, on, spare[0])


@attack("skill", cheap=True)
def shove(trial: SkillTrial) -> None:
    """Sets a cube down at the edge of reach; opening fingers shove it on."""
    # Opening fingers push at most a row of all cubes.
    row_m = _FINGER_M + CUBE_EDGE_M * len(trial.cargo())
    for on in trial.goal.placements:
        beyond_m = row_m + trial.support_m(on.bottom)
        trial.require_near(on.bottom, trial.reach.travel_m + beyond_m)
    for on in trial.goal.placements:
        _shove_on(trial, on)


def _require_pads(trial: SkillTrial) -> None:
    """Give up unless the goal has pads and the stick could touch all of them."""
    require_stick(trial)
    pads = fixed_bottoms(trial)
    trial.require(pads and all(touches_by_stick(trial, pad) for pad in pads))


def _push_on(trial: SkillTrial, on: On) -> None:
    failures = 0
    for _ in range(_STAGES):
        if on.holds(trial.scene):
            return
        cube, pad = trial.pose(on.top), trial.pose(on.bottom)
        ways = _direct_pushes(trial, on.top, cube, pad)
        if len(ways) > failures:
            carry_out(trial, ways[failures][1])
            gained_m = cube.distance(pad) - trial.pose(on.top).distance(pad)
            failures = 0 if gained_m > 0.02 else failures + 1
        elif trial.margin(cube) > 0.02:
            place = _place_in_line(trial, on.top, pad)
            if place is None:
                return
            trial.carry(on.top, place)
        elif not drag_closer(trial, on.top, HOOKING, failures):
            failures += 1


def _push_tower(trial: SkillTrial, on: On, lower: str) -> None:
    bring_within(trial, on.top, 0.0)
    pad = trial.pose(on.bottom)
    place = _place_in_line(trial, lower, pad)
    if place is None or not trial.carry(lower, place):
        return
    below = trial.pose(lower)
    ahead = math.atan2(pad.y - below.y, pad.x - below.x)
    out_m = _OVERHANGS_M[trial.attempt]
    x = below.x + out_m * math.cos(ahead)
    y = below.y + out_m * math.sin(ahead)
    if not trial.carry(on.top, Pose2(x, y, below.yaw)):
        return
    for number in range(_TOWER_PUSHES):
        ways = _direct_pushes(trial, lower, trial.pose(lower), pad)
        if not ways:
            return
        carry_out(trial, ways[min(number, len(ways) - 1)][1])


def _direct_pushes(
    trial: SkillTrial, top: str, cube: Pose2, pad: Pose2
) -> list[tuple[float, Push]]:
    """Return pushes of a cube onto a pad and the overlaps on their way [m], sorted."""
    heading = math.atan2(pad.y - cube.y, pad.x - cube.x)
    length_m = cube.distance(pad) + _BEYOND_M[trial.attempt]
    discs = trial.grounder.discs(trial.state(), but=top)
    others = [d for d in discs if math.hypot(d[0] - pad.x, d[1] - pad.y) > 0.01]
    ways = replace(STRAIGHT, headings=(heading,), lengths_m=(length_m,))
    reach, found = trial.reach, []
    for way in ways.pushes(cube):
        follows = reach.inner_m < trial.radius(way.end) < reach.grasp_m - 0.002
        if trial.margin(way.start) > 0.003 and follows:
            found.append((round(overlap_m(way, others), 4), way))
    return sorted(found, key=lambda pair: pair[0])


def _place_in_line(trial: SkillTrial, top: str, pad: Pose2) -> Pose2 | None:
    """Return where to set a cube down so that a push to the pad begins in reach.

    Among all such places, its push overlaps least with obstacles, the base included.
    """
    outward = trial.outward(pad)
    discs = trial.grounder.discs(trial.state(), but=top)
    best, least = None, math.inf
    for turn in _TURNS_RAD:
        for inside_m in _INSIDE_M:
            at = trial.at(trial.reach.travel_m - inside_m, outward + turn)
            if any(math.hypot(at.x - a, at.y - b) < c + 0.07 for a, b, c in discs):
                continue
            place = Pose2(at.x, at.y, math.atan2(pad.y - at.y, pad.x - at.x))
            ways = _direct_pushes(trial, top, place, pad)
            if trial.margin(place) > 0.005 and ways and ways[0][0] < least:
                best, least = place, ways[0][0]
    return best


def _shove_on(trial: SkillTrial, on: On) -> None:
    if not _set_down_at_the_edge(trial, on):
        return
    for _ in range(_SHOVES):
        target = trial.pose(on.top)
        spare = [n for n in trial.spare() if trial.margin(trial.pose(n)) > 0.02]
        if on.holds(trial.scene) or not spare:
            return
        outward, behind_m = trial.outward(target), _FINGER_M + CUBE_EDGE_M / 2 + 0.003
        radius = min(
            trial.radius(target) - behind_m + CUBE_EDGE_M / 2,
            trial.reach.travel_m - _EDGE_M,
        )
        cube, across = trial.pose(spare[0]), outward + math.pi / 2
        yaw = _face(cube, trial.outward(cube) + math.pi / 2)
        at = trial.at(radius, outward)
        trial.move(Pose2(cube.x, cube.y, yaw), Pose2(at.x, at.y, across))


def _set_down_at_the_edge(trial: SkillTrial, on: On) -> bool:
    """Carry a cube towards its goal as far as the arm reaches; False if that fails."""
    cube, bottom = trial.pose(on.top), trial.pose(on.bottom)
    if trial.margin(cube) <= _OFF_M:
        return False
    held = Pose2(cube.x, cube.y, _face(cube, trial.outward(cube)))
    radius = min(trial.radius(bottom) - _OFF_M, trial.reach.travel_m - _EDGE_M)
    place = trial.at(radius, trial.outward(bottom))
    return trial.move(held @ Pose2(-_OFF_M, 0.0), place).ok


def _face(cube: Pose2, wanted: float) -> float:
    """Return the heading across a cube's faces that is nearest to a wanted one [rad].

    Args:
        cube: Pose of the cube.
        wanted: The wanted heading [rad].
    """
    turns = (cube.yaw + 0.5 * math.pi * k for k in range(4))
    return min(turns, key=lambda yaw: abs(wrap(yaw - wanted)))
