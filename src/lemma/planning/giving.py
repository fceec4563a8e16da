"""Grounding of ``give``: who holds which end, and how the thing lies at its place."""

import math
from collections.abc import Iterator
from dataclasses import replace

from lemma.core.poses import Pose2
from lemma.motion.joint import meeting, nearest_robot
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.symbolic_state import SymbolicState
from lemma.planning.validity import why_not_give
from lemma.scene.objects.entity import kind_of
from lemma.scene.objects.kind import ObjectKind
from lemma.tasks.drags import HAND_CLEARANCE_M, Disc
from lemma.tasks.subtask import GroundedSubTask, SubTask

_ASIDE_M = 0.03
"""Least gap between the axis of a thing that is put down and what lies beside it."""
_YAWS = 24
_MARGIN_M = 0.01
_SAVED_S = 5.0
"""Both robots work at once for so long, or wait for each other less than alone [s]."""


def ground_give(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``give``: the robot takes the nearer end if it can, its partner the other.

    The partner is the robot that stands nearest to the place.
    """
    item, place, robot = subtask.pick, subtask.place, subtask.robot
    ends = kind_of(item).ends
    if ends is None or place not in now.poses or why_not_give(subtask, now):
        return None
    start, target, base = now.poses[item], now.poses[place], geometry.robots[robot].base
    bases = {name: placed.base for name, placed in geometry.robots.items()}
    partner = nearest_robot(bases, target, but=robot)
    if partner is None:
        return None
    if any(geometry.overload(name, item) for name in (robot, partner)):
        return None
    near, far = sorted(
        (grasp.at for grasp in ends), key=lambda at: base.distance(start @ at)
    )
    for mine, other in ((near, far), (far, near)):
        pair = (geometry.robots[robot], geometry.robots[partner])
        met = meeting(*pair, mine, other)
        if geometry.margin(robot, start @ mine, met @ mine) <= _MARGIN_M:
            continue
        if geometry.margin(partner, met @ other) <= _MARGIN_M:
            continue
        end = _lies(geometry, now, subtask, partner, met, other)
        if end is not None:
            hands = ((start @ mine, met @ mine), (met @ other, end @ other))
            return _option(geometry, subtask, now, partner, hands, end, end @ mine)
    return None


def _option(
    geometry: SceneGeometry,
    subtask: SubTask,
    now: SymbolicState,
    partner: str,
    hands: tuple[tuple[Pose2, Pose2], tuple[Pose2, Pose2]],
    end: Pose2,
    mine: Pose2,
) -> GroundedOption:
    """Return the option from where both hands are first and last.

    Args:
        geometry: The scene.
        subtask: The order.
        now: The state.
        partner: The robot that takes the thing.
        hands: Of the robot and its partner.
        end: Where the thing lies at the end.
        mine: Where the robot's hand would be at the end if it still held it.
    """
    robot, item = subtask.robot, subtask.pick
    parts = tuple(zip((robot, partner), hands, strict=True))
    times_s = [geometry.duration_s(name, *poses) for name, poses in parts]
    return GroundedOption(
        subtask,
        GroundedSubTask(robot, subtask.primitive, hands[0][0], mine),
        now.moved(item, end, subtask.place, f"on {subtask.place}"),
        min(geometry.quality(name, *poses) for name, poses in parts),
        times_s[0] + times_s[1] - _SAVED_S,
        theirs=GroundedSubTask(partner, subtask.primitive, *hands[1]),
    )


def _lies(
    geometry: SceneGeometry,
    now: SymbolicState,
    subtask: SubTask,
    taker: str,
    met: Pose2,
    grip: Pose2,
) -> Pose2 | None:
    """Return how the thing lies on its place: turned least of the free ways."""
    item, place = subtask.pick, subtask.place
    there = {name: at for name, at in now.poses.items() if name != place}
    discs = geometry.discs(replace(now, poses=there), but=item)
    base, target = geometry.robots[taker].base, now.poses[place]
    # With the arm it turns by as much as the direction of the place from the base.
    turn = math.atan2(target.y - base.y, target.x - base.x)
    turn -= math.atan2(met.y - base.y, met.x - base.x)
    for more in _turns():
        end = Pose2(target.x, target.y, met.yaw + turn + more)
        hand = end @ grip
        if geometry.margin(taker, hand) > _MARGIN_M and _is_free(
            kind_of(item), end, hand, discs
        ):
            return end
    return None


def _turns() -> Iterator[float]:
    """Yield angles over a whole turn, small ones first [rad]."""
    step = math.tau / _YAWS
    for k in range(_YAWS):
        yield step * ((k + 1) // 2) * (1.0 if k % 2 else -1.0)


def _is_free(kind: ObjectKind, at: Pose2, hand: Pose2, discs: tuple[Disc, ...]) -> bool:
    """Whether nothing lies below a thing that is put down, or in the hand's way."""
    half_m = kind.disc_m
    for x, y, radius in discs:
        local = at.inverse() @ Pose2(x, y)
        along = max(0.0, abs(local.x) - half_m)
        if math.hypot(along, local.y) < radius + _ASIDE_M:
            return False
        if hand.distance(Pose2(x, y)) < radius + HAND_CLEARANCE_M:
            return False
    return True
