"""Pull a cube nearer with the fingertips of a leaning hand, then pick and place."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control.tilted_move import put_on
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, drawn_back, leaning, moved
from lemma.audit.handling import stand_by
from lemma.core.poses import FloatArray
from lemma.robots.gripper import FINGERTIP_BEYOND_TCP_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of

_PRESS_M = 0.004
_HALF_M = CUBE_EDGE_M / 2
_STROKES = 3
_STEP_M = 0.03


def rake(trial: ControlTrial) -> None:
    """Play an attempt: from above, then behind its far face, then on its near edge."""
    cubes = [name for name in trial.goal.entities if kind_of(name).cargo]
    far = [name for name in cubes if not _is_home(trial, name)]
    for name in trial.goal.entities:
        disc_m, support_m = kind_of(name).disc_m, kind_of(name).support_m or 0.0
        limit_m = trial.could.radius_m(disc_m, support_m)
        if trial.radius(trial.pose(name)) > limit_m:
            # What cannot be touched can neither be raked nor built upon.
            raise GiveUp
    for name in far:
        for _ in range(_STROKES):
            if _is_home(trial, name) or not _stroke(trial, name):
                break
    for on in trial.goal.conjuncts:
        put_on(trial, on)


def _is_home(trial: ControlTrial, name: str) -> bool:
    return trial.radius(trial.pose(name)) < trial.reach.travel_m - 0.01


def _stroke(trial: ControlTrial, name: str) -> bool:
    """Pull a cube once, as far as the hand keeps its lean; False if it cannot."""
    start = _start(trial, name)
    if start is None:
        return False
    opening_m = 0.0
    above = moved(drawn_back(start, 0.06), dz=0.06)
    if not trial.can(above):
        above = drawn_back(start, 0.06)
    if not trial.go(stand_by(trial, start), opening_m):
        return False
    if not (trial.go(above, opening_m) and trial.lead([start], opening_m, 0.12)):
        return False
    inward = trial.outward(trial.pose(name)) + math.pi
    length = trial.radius(trial.pose(name)) - trial.reach.travel_m + 0.08
    steps = [
        moved(start, i * _STEP_M * math.cos(inward), i * _STEP_M * math.sin(inward))
        for i in range(1, max(2, math.ceil(length / _STEP_M)) + 1)
    ]
    trial.lead(steps, opening_m, 0.08)
    up = moved(trial.hand(), dz=0.10)
    if trial.can(up):
        trial.lead([up], opening_m, 0.2)
    return True


def _start(trial: ControlTrial, name: str) -> FloatArray | None:
    """Return where the fingertips begin to pull, with the least lean."""
    cube, outward = trial.pose(name), trial.outward(trial.pose(name))
    top = trial.height(name) + _HALF_M
    ahead_m, z = (
        (0.005, top - _PRESS_M),
        (_HALF_M + 0.012, top - 0.03),
        (-0.015, top - _PRESS_M),
    )[trial.attempt]
    for lean in LEANS_RAD:
        tip = leaning(
            cube.x + ahead_m * math.cos(outward),
            cube.y + ahead_m * math.sin(outward),
            z,
            outward,
            lean,
        )
        hand = drawn_back(tip, FINGERTIP_BEYOND_TCP_M)
        if trial.can(hand, drawn_back(hand, 0.06)):
            return hand
    return None


ATTACKS.add(
    "rake",
    Attack(
        name="rake",
        summary="Pulls cubes nearer with the fingertips of a leaning hand.",
        level="control",
        play=rake,
        attempts=3,
        cheap=True,
    ),
)
