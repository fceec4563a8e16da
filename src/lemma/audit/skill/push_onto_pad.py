"""Push a cube onto a pad that is out of reach, with the stick."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.pushes import (
    BAR_GRASPS,
    CORNER,
    HANDLE_GRASPS,
    HEAD,
    OUTSIDE,
    TIP,
    Push,
    overlap_m,
    push,
)
from lemma.audit.skill.stick_work import (
    HOOKING,
    carry_out,
    drag_closer,
    fixed_bottoms,
    require_stick,
    touches_by_stick,
)
from lemma.audit.skill_trial import SkillTrial
from lemma.core.poses import Pose2
from lemma.tasks.goal import On

_BEYOND_M = (0.0, 0.03, 0.055)
"""How far beyond the pad's middle a push aims, by attempt."""
_CONTACTS = (HEAD, CORNER, OUTSIDE, TIP)
_GRASPS = (*HANDLE_GRASPS[:3], BAR_GRASPS[1])
_STAGES = 6
_TURNS_RAD = (0.0, 0.12, -0.12, 0.25, -0.25, 0.4, -0.4, 0.7, -0.7)


def push_onto_pad(trial: SkillTrial) -> None:
    """Play an attempt."""
    require_stick(trial)
    pads = fixed_bottoms(trial)
    near = [pad for pad in pads if touches_by_stick(trial, trial.pose(pad))]
    if not pads or len(near) < len(pads):
        raise GiveUp
    for on in trial.goal.conjuncts:
        _push_on(trial, on)


def _push_on(trial: SkillTrial, on: On) -> None:
    failures = 0
    for _ in range(_STAGES):
        if on.holds(trial.scene):
            return
        cube, pad = trial.pose(on.top), trial.pose(on.bottom)
        ways = direct_pushes(trial, on.top, cube, pad)
        if len(ways) > failures:
            before = cube.distance(pad)
            carry_out(trial, ways[failures], hooks=False)
            gained = before - trial.pose(on.top).distance(pad)
            failures = 0 if gained > 0.02 else failures + 1
        elif trial.margin(cube) > 0.02:
            place = place_in_line(trial, on.top, pad)
            if place is None:
                return
            pick = trial.grounder.grasp(trial.robot, on.top, trial.state())
            assert pick is not None
            trial.move(pick, place)
        elif not drag_closer(trial, on.top, HOOKING, failures):
            failures += 1


def direct_pushes(trial: SkillTrial, top: str, cube: Pose2, pad: Pose2) -> list[Push]:
    """Return pushes that would take a cube onto a pad, the freest first."""
    return [way for _, way in _rated_pushes(trial, top, cube, pad)]


def _rated_pushes(
    trial: SkillTrial, top: str, cube: Pose2, pad: Pose2
) -> list[tuple[float, Push]]:
    """Return pushes and how much is in the way of each [m], the freest first."""
    heading = math.atan2(pad.y - cube.y, pad.x - cube.x)
    beyond = _BEYOND_M[trial.attempt % len(_BEYOND_M)]
    length = cube.distance(pad) + beyond
    discs = [
        disc
        for disc in trial.grounder.discs(trial.state(), but=top)
        if math.hypot(disc[0] - pad.x, disc[1] - pad.y) > 0.01
    ]
    found = []
    for contact in _CONTACTS:
        for grasp in _GRASPS:
            way = push(contact, grasp, cube, heading, length)
            if trial.margin(way.start) > 0.003 and _follows(trial, way.end):
                found.append((round(overlap_m(way, discs), 4), way))
    return sorted(found, key=lambda pair: pair[0])


def _follows(trial: SkillTrial, end: Pose2) -> bool:
    reach = trial.reach
    return reach.inner_m < trial.radius(end) < reach.grasp_m - 0.002


def place_in_line(trial: SkillTrial, top: str, pad: Pose2) -> Pose2 | None:
    """Return where to set a cube down so that a push to the pad begins in reach.

    Of all places that with least in the way of the push, such as one's own base.
    """
    outward = trial.outward(pad)
    discs = trial.grounder.discs(trial.state(), but=top)
    best, least = None, math.inf
    for turn in _TURNS_RAD:
        for inside_m in (0.02, 0.06, 0.12, 0.2, 0.3):
            x, y = trial.at(trial.reach.travel_m - inside_m, outward + turn)
            if any(math.hypot(x - a, y - b) < c + 0.07 for a, b, c in discs):
                continue
            place = Pose2(x, y, math.atan2(pad.y - y, pad.x - x))
            ways = _rated_pushes(trial, top, place, pad)
            if trial.margin(place) > 0.005 and ways and ways[0][0] < least:
                best, least = place, ways[0][0]
    return best


ATTACKS.add(
    "push_onto_pad",
    Attack(
        name="push_onto_pad",
        summary="Hooks a cube home, sets it down in line, pushes it onto its pad.",
        level="skill",
        play=push_onto_pad,
        attempts=len(_BEYOND_M),
    ),
)
