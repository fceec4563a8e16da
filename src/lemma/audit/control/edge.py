"""Attacks at the edge of reach: a cube gets the last few centimetres without a hand.

It is knocked or squeezed off another one, so softly that it counts as not thrown
(:mod:`lemma.scene.coasting`).
"""

import math
from collections.abc import Iterator
from itertools import product, takewhile

from lemma.audit.attack import attack
from lemma.audit.control_trial import (
    LEANS_RAD,
    ControlTrial,
    drawn_back,
    leaning,
    moved,
)
from lemma.core.poses import FloatArray, Pose2
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.coasting import COAST_M
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.goal import On

# Geometry forbids success farther out; the attacks still act up to this distance more.
_DOUBT_M = 0.05
_HALF_M = CUBE_EDGE_M / 2
_CORNER_M = _HALF_M * math.sqrt(2.0)
_STEP_M = 0.01
_REST_S = 0.8
# Distance inside the farthest place at which a cube is set down, by attempt.
_INSIDE_M = (0.03, 0.08)
_KNOCKS_M_S = (0.15, 0.25, 0.32, 0.38, 0.44, 0.5, 0.6)
_KNOCKED_AT_M = (0.0, 0.015)


@attack(
    "control", attempts=len(_INSIDE_M), candidates=len(_KNOCKS_M_S) * len(_KNOCKED_AT_M)
)
def knock_off(trial: ControlTrial) -> None:
    """Stands a cube on another at the edge of reach, and knocks it onto its goal."""
    on, step = _goal_and_step(trial)
    if not _build(trial, on, step, _INSIDE_M[trial.attempt]):
        return
    path = _behind(trial, on, 0.10)
    if not path or not trial.approach(path[0], 0.0, lift_m=0.05):
        return

    def knock(option: tuple[float, float]) -> None:
        speed_m_s, raise_m = option
        raised = [moved(hand, dz=raise_m) for hand in path]
        trial.lead(list(takewhile(trial.can, raised)), 0.0, speed_m_s)
        trial.wait(_REST_S, 0.0)
        trial.lead([path[0]], 0.0, 0.2)
        trial.wait(_REST_S)

    trial.try_each(product(_KNOCKS_M_S, _KNOCKED_AT_M), knock)


# How deep the closing fingertips overlap the cube [m].
_BITES_M = (0.002, 0.005, 0.008, 0.012)
_BITE_SIDES_M = (0.0, 0.004)
_SQUEEZE_S = 0.5


@attack(
    "control", attempts=len(_INSIDE_M), candidates=len(_BITES_M) * len(_BITE_SIDES_M)
)
def squeeze_out(trial: ControlTrial) -> None:
    """Stands a cube on another, and squeezes it out between the closing fingertips."""
    on, step = _goal_and_step(trial)
    if not _build(trial, on, step, _INSIDE_M[trial.attempt]):
        return
    cube, z = trial.pose(on.top), trial.height(on.top)
    bearing = trial.outward(trial.pose(on.bottom))
    # The corner that points inwards most.
    corner = min(
        (cube.yaw + math.pi * (0.25 + 0.5 * k) for k in range(4)),
        key=lambda yaw: math.cos(yaw - bearing),
    )
    x = cube.x + _CORNER_M * math.cos(corner)
    y = cube.y + _CORNER_M * math.sin(corner)

    def squeeze(option: tuple[float, float]) -> None:
        bite_m, beside_m = option
        spot = Pose2(x, y, bearing) @ Pose2(bite_m, beside_m)
        for lean in LEANS_RAD[6:]:
            hand = drawn_back(leaning(spot, z, lean), 0.012)
            if trial.can(hand, drawn_back(hand, 0.06)):
                break
        else:
            return
        if trial.approach(hand, FINGER_OPENING_M, 0.06, lift_m=0.05):
            trial.wait(_SQUEEZE_S, 0.0)
            trial.wait(_REST_S)
            trial.lead([drawn_back(hand, 0.08)], FINGER_OPENING_M, 0.2)
            trial.wait(_REST_S)

    trial.try_each(product(_BITES_M, _BITE_SIDES_M), squeeze)


def _goal_and_step(trial: ControlTrial) -> tuple[On, str]:
    """Return the only conjunct and a spare cube; give up if either is not usable."""
    on = trial.goal.placements[0]
    trial.require(len(trial.goal.placements) == 1 and trial.is_home(on.top))
    beyond_m = _CORNER_M + COAST_M + trial.support_m(on.bottom) + _DOUBT_M
    trial.require_near(on.bottom, trial.could.touch_m + beyond_m)
    spare = [name for name in trial.spare() if trial.is_home(name)]
    trial.require(spare)
    return on, spare[0]


def _build(trial: ControlTrial, on: On, step: str, inside_m: float) -> bool:
    """Stand the top of a goal on a cube as near to its bottom as the hand gets."""
    bearing = trial.outward(trial.pose(on.bottom))
    if not _stand_far(trial, step, bearing, 0.0, inside_m):
        return False
    return _stand(trial, on.top, trial.pose(step), CUBE_EDGE_M, bearing)


def _stand_far(
    trial: ControlTrial, name: str, bearing: float, bottom_m: float, inside_m: float
) -> bool:
    """Stand a cube as far out as the hand gets; False if that fails."""
    most_m = trial.could.place_m
    radii = (most_m - inside_m - 0.02 * i for i in range(20))
    spots = (trial.at(radius_m, bearing) for radius_m in radii)
    return any(_stand(trial, name, spot, bottom_m, bearing) for spot in spots)


def _stand(
    trial: ControlTrial, name: str, spot: Pose2, bottom_m: float, bearing: float
) -> bool:
    """Stand a cube at a spot with the least lean; False if that fails."""
    z, above_m = bottom_m + _HALF_M + 0.004, 0.06
    at = Pose2(spot.x, spot.y, bearing)
    for lean in LEANS_RAD:
        put = drawn_back(leaning(at, z, lean), 0.015)
        if not trial.can(put, drawn_back(put, above_m), moved(put, dz=0.10)):
            continue
        hold = next(trial.holds(name, lean, 0.015), None)
        if hold is None:
            continue
        if not trial.pick_up(hold) or not trial.put(put, above_m, lift_m=0.06):
            return False
        stands = abs(trial.height(name) - bottom_m - _HALF_M) < 0.01
        return stands and trial.pose(name).distance(spot) < 0.03
    return False


def _behind(trial: ControlTrial, on: On, length_m: float) -> list[FloatArray]:
    """Return the longest path of hands outwards from behind the goal's top."""
    cube, z = trial.pose(on.top), trial.height(on.top) - 0.005
    bearing = math.atan2(
        trial.pose(on.bottom).y - cube.y, trial.pose(on.bottom).x - cube.x
    )
    start = Pose2(cube.x, cube.y, bearing) @ Pose2(-_CORNER_M - 0.02, 0.0)

    def ways() -> Iterator[list[FloatArray]]:
        for lean in LEANS_RAD:
            count = round(length_m / _STEP_M) + 1
            spots = (start @ Pose2(i * _STEP_M, 0.0) for i in range(count))
            hands = (drawn_back(leaning(spot, z, lean), 0.008) for spot in spots)
            path = list(takewhile(trial.can, hands))
            if path and trial.can(drawn_back(path[0], 0.10)):
                yield path

    return max(ways(), key=len, default=[])
