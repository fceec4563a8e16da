"""A cube pushed by cubes behind it, and these by the fingers of a leaning hand.

Or a tower is the first of the row, with the cube as its upper one. It stands out, to
tip over onto the pad where the lower one is stopped.
"""

import math

from lemma.audit.attack import ATTACKS, Attack, GiveUp, Lost
from lemma.audit.chain.row import GAP_M, Line, build_row, line_to, put_on_first
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import LEANS_RAD, leaning, moved
from lemma.audit.handling import approach, farthest, is_home
from lemma.core.poses import FloatArray
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of

_WAYS: tuple[tuple[int | None, float | None], ...] = (
    (None, None),
    (None, 0.013),
    (None, 0.018),
    (None, 0.023),
    (1, None),
    (1, 0.018),
    (1, 0.023),
)
"""How many spare cubes are in the row, all if None, and how far the upper cube of a
tower stands out, None without one [m]; by attempt."""
_BEHIND_M = CUBE_EDGE_M / 2 + 0.035
_LOW_M = 0.02
_STEP_M = 0.02
_SPEEDS_M_S = (0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.65, 0.8)
"""Of the push; a row that is fast slides on."""
_SLIDE_M = 0.10
_RAISE_M = 0.08
_REST_S = 1.5
_SLACK_M = 0.015


def cube_chain(trial: ControlTrial) -> None:
    """Play an attempt."""
    number, out_m = _WAYS[trial.attempt]
    on = trial.goal.conjuncts[0]
    spare = [
        name
        for name in trial.cargo()
        if name not in trial.goal.entities and is_home(trial, name)
    ]
    if number is not None and len(spare) <= number:
        raise GiveUp
    spare = spare[:number]
    pad, kind = trial.pose(on.bottom), kind_of(on.bottom)
    row_m = (len(spare) + 1) * (CUBE_EDGE_M + GAP_M)
    farthest_m = trial.could.touch_m + row_m + _SLIDE_M + kind.disc_m
    home = spare and is_home(trial, on.top)
    if not home or trial.radius(pad) > farthest_m:
        raise GiveUp
    line = line_to(trial, pad, 0.0)
    row = [on.top, *spare] if out_m is None else spare
    if not build_row(trial, row, line):
        return
    if out_m is not None and not put_on_first(trial, on.top, row[0], line, out_m):
        return
    path = _path(trial, line, row)
    if not path or not approach(trial, path[0], 0.0, lift_m=0.06):
        return
    ready = trial.snapshot()
    for speed in _SPEEDS_M_S:
        trial.restore(ready)
        try:
            trial.lead(path, 0.0, speed)
            trial.lead([moved(path[0], dz=_RAISE_M)], 0.0, 0.2)
            trial.wait(_REST_S, 0.0)
        except Lost:
            continue


def _path(trial: ControlTrial, line: Line, row: list[str]) -> list[FloatArray]:
    """Return the farthest way that a hand of one lean can push the row."""
    start_m = line.before_m(trial.pose(row[-1])) + _BEHIND_M
    length_m = line.before_m(trial.pose(row[0])) + len(row) * _SLACK_M
    spots = [
        line.at(start_m - min(length_m, i * _STEP_M))
        for i in range(math.ceil(length_m / _STEP_M) + 1)
    ]
    return farthest(
        trial,
        (
            (leaning(at.x, at.y, _LOW_M, at.yaw, lean) for at in spots)
            for lean in LEANS_RAD[:14]
        ),
    )


ATTACKS.add(
    "cube_chain",
    Attack(
        name="cube_chain",
        summary="Pushes a cube to its pad with the cubes behind it in a row.",
        level="control",
        play=cube_chain,
        attempts=len(_WAYS),
    ),
)
