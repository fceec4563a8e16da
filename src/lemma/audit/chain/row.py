"""Cubes in a row, set down where they shall be pushed from behind."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lemma.audit.control.stick_in_hand import hook_home, lay_stick
from lemma.audit.control_trial import ControlTrial
from lemma.audit.hand import leaning
from lemma.audit.handling import base_to, is_home, set_down
from lemma.audit.pushes import END_GRASP
from lemma.core.poses import Pose2
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.drags import stick_gap

GAP_M = 0.004
"""Between two cubes of a row when they are set down."""
_HIGH_M = 0.20
_SPOTS = 12
_SPOT_STEP_M = 0.02


@dataclass(frozen=True)
class Line:
    """The line along which a row is pushed: it ends in the middle of a pad."""

    end: Pose2
    """The pad, and the direction of the push as the yaw."""

    def at(self, before_m: float) -> Pose2:
        """Return the position so far before the end."""
        return self.end @ Pose2(-before_m, 0.0)

    def before_m(self, pose: Pose2) -> float:
        """Return how far before the end a position is [m]."""
        return -(self.end.inverse() @ pose).x


def line_to(trial: ControlTrial, pad: Pose2, beside_m: float) -> Line:
    """Return the line to a pad that passes the robot's base at a distance.

    Args:
        trial: The attempt.
        pad: Where it ends.
        beside_m: How far left of the base it passes; right if negative [m].
    """
    turn = math.asin(beside_m / trial.radius(pad))
    return Line(Pose2(pad.x, pad.y, trial.outward(pad) - turn))


def fetch(trial: ControlTrial, name: str) -> bool:
    """Hook a cube home if need be, and lay the stick down; False if that fails."""
    if is_home(trial, name):
        return True
    if not hook_home(trial, name):
        return False
    lay_stick(trial, END_GRASP, _aside(trial))
    return is_home(trial, name)


def _aside(trial: ControlTrial) -> Pose2:
    """Return where the stick can lie, pointing outwards, farthest from all cubes."""
    base = trial.placement.base

    def gap_m(stick: Pose2) -> float:
        cubes = (trial.pose(name) for name in trial.cargo())
        return min(stick_gap(stick, cube.x, cube.y) for cube in cubes)

    grips = (
        base_to(trial, 0.5 * trial.reach.travel_m, base.yaw + 0.2 * turn)
        for turn in range(-7, 8)
    )
    return max((grip @ END_GRASP.inverse() for grip in grips), key=gap_m)


def build_row(trial: ControlTrial, names: Sequence[str], line: Line) -> bool:
    """Set cubes down in a row, the first as far ahead as the hand gets."""
    for i in range(_SPOTS):
        before_m = line.before_m(trial.placement.base) - trial.reach.grasp_m
        spot = line.at(before_m + 0.01 + i * _SPOT_STEP_M)
        # Another cube will be put on the first, and a little ahead.
        ahead = spot @ Pose2(CUBE_EDGE_M / 2, 0.0)
        if trial.can(leaning(ahead.x, ahead.y, _HIGH_M, spot.yaw, 0.0)):
            break
    else:
        return False
    first_m = line.before_m(spot)
    return all(
        set_down(trial, names[i], line.at(first_m + i * (CUBE_EDGE_M + GAP_M)))
        for i in range(len(names))
    )


def put_on_first(
    trial: ControlTrial, name: str, first: str, line: Line, out_m: float
) -> bool:
    """Put a cube on the first of a row, standing out ahead; False if that fails."""
    upper = line.at(line.before_m(trial.pose(first)) - out_m)
    return set_down(trial, name, upper, CUBE_EDGE_M)
