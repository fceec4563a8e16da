"""Push a cube onto its pad with the hand, or with another cube that it holds."""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, leaning, moved
from lemma.audit.handling import (
    approach,
    base_to,
    farthest,
    holds,
    let_go,
    pick_up,
    stand_by,
)
from lemma.core.poses import FloatArray, Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.goal import On

_FINGERS_M = 0.015
"""Half of two closed fingers."""
_STEP_M = 0.02


def hand_push(trial: ControlTrial) -> None:
    """Play an attempt: with closed fingers, then with another cube in the hand."""
    held_m = CUBE_EDGE_M if trial.attempt else 0.0
    for on in trial.goal.conjuncts:
        support_m = kind_of(on.bottom).support_m or 0.0
        limit_m = trial.could.touch_m + CUBE_EDGE_M / 2 + held_m + support_m
        if trial.radius(trial.pose(on.bottom)) > limit_m:
            raise GiveUp
    for on in trial.goal.conjuncts:
        _push_on(trial, on)


def _push_on(trial: ControlTrial, on: On) -> None:
    if not _bring_in_line(trial, on):
        return
    half_m = _FINGERS_M
    if trial.attempt and not _take_another(trial):
        return
    if trial.attempt:
        half_m = CUBE_EDGE_M / 2
    cube, pad = trial.pose(on.top), trial.pose(on.bottom)
    heading = math.atan2(pad.y - cube.y, pad.x - cube.x)
    back_m = CUBE_EDGE_M / 2 + half_m + 0.015
    length = cube.distance(pad) + 0.015
    path = _path(trial, cube, heading, back_m, length, 0.03)
    if not path:
        return
    if not trial.go(stand_by(trial, path[0]), 0.0):
        return
    above = moved(path[0], dz=0.08)
    if trial.can(above):
        trial.go(above, 0.0)
    if trial.lead(path[:1], 0.0, 0.1):
        trial.lead(path[1:], 0.0, 0.1)
    trial.lead([moved(trial.hand(), dz=0.05)], 0.1, 0.2)


def _path(
    trial: ControlTrial,
    cube: Pose2,
    heading: float,
    back_m: float,
    length: float,
    z: float,
) -> list[FloatArray]:
    """Return the longest way that a hand of one lean can push."""
    start = Pose2(cube.x, cube.y, heading)
    spots = [
        start @ Pose2(min(length, i * _STEP_M) - back_m, 0.0)
        for i in range(math.ceil(length / _STEP_M) + 1)
    ]
    return farthest(
        trial,
        (
            (leaning(at.x, at.y, z, heading, lean) for at in spots)
            for lean in LEANS_RAD[::2]
        ),
    )


def _bring_in_line(trial: ControlTrial, on: On) -> bool:
    """Set the cube down between the robot and the pad, near the edge of reach."""
    outward = trial.outward(trial.pose(on.bottom))
    spot = base_to(trial, trial.reach.travel_m - 0.06, outward)
    hold = next(holds(trial, on.top, 0.0, 0.0), None)
    if hold is None or not pick_up(trial, hold.hand):
        return False
    put = leaning(spot.x, spot.y, trial.height(on.bottom) + 0.03, outward, 0.0)
    put[2, 3] = kind_of(on.top).origin_m + 0.003
    if not trial.can(put) or not approach(trial, put, 0.0, 0.08):
        return False
    let_go(trial, put)
    return True


def _take_another(trial: ControlTrial) -> bool:
    """Take a cube in the hand that the goal does not need."""
    for name in trial.cargo():
        if name not in trial.goal.entities:
            hold = next(holds(trial, name, 0.0, 0.0), None)
            if hold is not None and pick_up(trial, hold.hand):
                return True
    return False


ATTACKS.add(
    "hand_push",
    Attack(
        name="hand_push",
        summary="Pushes a cube to its pad with the hand, or with a cube in it.",
        level="control",
        play=hand_push,
        attempts=2,
        cheap=True,
    ),
)
