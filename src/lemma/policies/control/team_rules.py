"""Rules that demonstrate a hand-over, as a function of the state.

They label the states that a learning network visits; see ``scripts/learn_a_team.py``.
The robot that acts is the one that grips the object, or else one that reaches both the
object and its place, or else the one that reaches the object. It puts the object on its
place, or into the middle of the region that both robots reach. The other robot opens
its fingers, rises and goes home; until it is out of the way, the acting hand waits.
Since the rules have no memory, the same state always has the same action.
"""

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import (
    GRIP_M,
    HOLDS,
    OBJECT,
    PLACE,
    STEP_M,
    TURN_RAD,
    wrapped,
)
from lemma.policies.control.team_steps import (
    CUBE_M,
    Team,
    TeamPolicy,
)

_CLOSED_M, _OPEN_M = 0.04, 0.09
"""Commanded openings below which fingers grip a cube, and above which they are open
[m]."""
_AROUND_M, _GRASP_M, _TURN_RAD = 0.02, 0.01, 0.12
"""Distance within which fingers around an object stay there; distance [m] and yaw error
[rad] within which they close."""
_HIGH_M, _LOW_M, _ASIDE_M, _SLOPE = 0.15, 0.06, 0.012, 2.5
"""Height above a grasp at which an empty hand travels; height above which it aligns;
and horizontal distance and slope of its descent [m, m, m, 1]."""
_CARRY_M, _SAG_M = 0.12, 0.05
"""Height of a carried object above its place, and how much lower it may be on the way
[m]."""
_ON_M, _AT_M = 0.008, 0.008
"""Horizontal and vertical distance from the place within which fingers open [m]."""
_LOWER, _PRESSED_M = -0.25, -0.026
"""Action that lowers an object over its place, and lead of the target at which the
object is known to rest on something, such as a distractor [m]."""
_DONE_M, _DONE_UP_M = 0.02, 0.012
"""The same distances within which a released object is in its place [m]."""
_CLEAR_M, _HOME_M = 0.4, 0.15
"""A hand is out of the way if it is this far from the object, or this near to its home
[m]."""


def demonstrate(team: Team) -> Tensor:
    """Return the action rows of both hands by the rules, (..., 2, 5)."""
    goal = team.goal
    way, up = goal[..., OBJECT : OBJECT + 2], goal[..., OBJECT + 2]
    beside = torch.linalg.vector_norm(way, dim=-1)
    holds, opening = goal[..., HOLDS] > 0.5, team.asked
    around = (beside < _AROUND_M) & (up.abs() < _AROUND_M)
    grips = holds | (around & (opening < _CLOSED_M))
    acts = _acting(team, grips)
    fetched, retreated = _fetch(team, beside, around), _retreat(team, beside)
    rows = torch.where(acts[..., None], fetched, retreated)
    rows = torch.where((acts & grips)[..., None], _carry(team), rows)
    return rows.clamp(-1.0, 1.0)


def _acting(team: Team, grips: Tensor) -> Tensor:
    """Return which robot acts, (..., 2); none if the object is released in place."""
    has, puts = team.margins(team.object), team.margins(team.place)
    direct = torch.minimum(has, puts)
    some = (direct > 0.0).any(-1, keepdim=True)
    score = torch.where(some, direct, has) + 10.0 * grips
    first = score[..., :1] >= score[..., 1:]
    acts = torch.cat([first, ~first], -1)
    place = team.goal[..., PLACE : PLACE + 3]
    there = torch.linalg.vector_norm(place[..., :2], dim=-1) < _DONE_M
    there &= place[..., 2].abs() < _DONE_UP_M
    found: Tensor = acts & ~(there & ~grips.any(-1, keepdim=True))
    return found


def _steps(team: Team, way: Tensor, up: Tensor, turn: Tensor, grip: Tensor) -> Tensor:
    """Return rows that move hands by vectors from where they are, (..., 2, 5).

    Args:
        team: The state.
        way: Forward and left, (..., 2, 2) [m].
        up: (..., 2) [m].
        turn: (..., 2) [rad].
        grip: Last column of the rows, (..., 2).
    """
    lead = team.target - team.here
    ahead = (way - team.seen(lead[..., :2])) / STEP_M
    # Shorten the vector, so that its direction is kept.
    length = torch.linalg.vector_norm(ahead, dim=-1, keepdim=True)
    ahead = ahead / length.clamp_min(1.0)
    rise = (up - lead[..., 2]) / STEP_M
    turned = wrapped(turn - lead[..., 3]) / TURN_RAD
    return torch.stack([*ahead.unbind(-1), rise, turned, grip], -1)


def _fetch(team: Team, beside: Tensor, around: Tensor) -> Tensor:
    """Go over the object, descend, and close the fingers, once the others are away."""
    goal = team.goal
    way, up = goal[..., OBJECT : OBJECT + 2], goal[..., OBJECT + 2]
    turn = goal[..., OBJECT + 3]
    above = -up
    aligned = (turn.abs() < _TURN_RAD) & (team.asked > _OPEN_M)
    wanted = (_SLOPE * (beside - _ASIDE_M)).clamp(0.0, _HIGH_M)
    wanted = torch.where(aligned, wanted, wanted.clamp_min(_LOW_M))
    # Horizontal steps are allowed at about the right height.
    free = ((above - wanted + 0.04) / 0.02).clamp(0.0, 1.0)
    closes = (beside < _GRASP_M) & (up.abs() < _GRASP_M)
    closes = closes & (turn.abs() < _TURN_RAD) | around & (team.asked < _OPEN_M)
    grip = torch.where(closes, -1.0, 1.0)
    still = torch.zeros_like(up)
    rows = _steps(team, way * free[..., None], wanted - above, turn, grip)
    stays = torch.stack([still, still, still, still, grip], -1)
    far = torch.linalg.vector_norm(team.here[..., :2] - team.object, dim=-1) > _CLEAR_M
    home = torch.linalg.vector_norm((team.home - team.here)[..., :3], dim=-1) < _HOME_M
    clear = (far | home).flip(-1)
    return torch.where((closes | ~clear)[..., None], stays, rows)


def _carry(team: Team) -> Tensor:
    """Close the fingers, carry the object to its next place, and open them there."""
    goal = team.goal
    puts = team.margins(team.place) > 0.0
    handed = team.seen(team.shared - team.object)
    place = goal[..., PLACE : PLACE + 3]
    way = torch.where(puts[..., None], place[..., :2], handed)
    up = torch.where(puts, place[..., 2], CUBE_M - team.height)
    beside = torch.linalg.vector_norm(way, dim=-1)
    wanted = (_SLOPE * (beside - _ASIDE_M)).clamp(0.0, _CARRY_M)
    rise = wanted + up
    free = ((_SAG_M - rise) / 0.02).clamp(0.0, 1.0)
    over, lead = beside < _ON_M, (team.target - team.here)[..., 2]
    opens = over & ((up.abs() < _AT_M) | (lead < _PRESSED_M))
    grip = torch.where(opens, 1.0, -1.0)
    still = torch.zeros_like(up)
    rows = _steps(team, way * free[..., None], rise.clamp(min=-0.02), still, grip)
    # Over the place, the lead grows as soon as the object rests on something.
    lower = torch.where(over & (up < -_AT_M), _LOWER, rows[..., 2])
    rows = torch.cat([rows[..., :2], lower[..., None], rows[..., 3:]], -1)
    stays = torch.stack([still, still, still, still, grip], -1)
    firm = team.asked < _CLOSED_M - 0.5 * GRIP_M
    return torch.where((opens | ~firm)[..., None], stays, rows)


def _retreat(team: Team, beside: Tensor) -> Tensor:
    """Open the fingers, rise, and go home."""
    goal = team.goal
    above = -goal[..., OBJECT + 2]
    near = (beside < 0.1) & (above < _LOW_M + 0.04)
    shut = near & (team.asked < 0.07)
    home = team.home
    way = team.seen((home - team.here)[..., :2])
    up = home[..., 2] - team.here[..., 2]
    free = ((team.here[..., 2] - _HIGH_M) / 0.02).clamp(0.0, 1.0) * ~near
    turn = wrapped(home[..., 3] - team.here[..., 3]) * free
    grip = torch.ones_like(up)
    rows = _steps(team, way * free[..., None], up, turn, grip)
    still = torch.zeros_like(up)
    stays = torch.stack([still, still, still, still, grip], -1)
    return torch.where(shut[..., None], stays, rows)


class TeamRules(TeamPolicy):
    """Plays the demonstrations: :func:`demonstrate` instead of a network."""

    def __init__(self) -> None:
        """Need no weights."""

    def rows(self, team: Team) -> Tensor:
        """Return the action of both hands, (2, 5)."""
        return demonstrate(team)
