"""Grounding of ``carry``: two robots, a thing with two handles, and where it goes."""

import math

from lemma.core.poses import Pose2
from lemma.motion.joint import CARRY_M_S, nearest_robot
from lemma.planning.geometry import GroundedOption, SceneGeometry
from lemma.planning.symbolic_state import SymbolicState
from lemma.planning.validity import why_not_carry
from lemma.robots.reach import TRAVEL_HEIGHT_M
from lemma.scene.objects.entity import kind_of
from lemma.tasks.subtask import GroundedSubTask, SubTask

_UP_AND_DOWN_M = 2.0 * TRAVEL_HEIGHT_M
_ONE_HAND_S = 1.5
"""Time to lift and lower that the prediction for one hand counts [s]."""


def ground_carry(
    geometry: SceneGeometry, subtask: SubTask, now: SymbolicState
) -> GroundedOption | None:
    """Ground ``carry``: the robot has the nearer handle, its partner the other one.

    The objects on it go with it.
    """
    item, place, robot = subtask.pick, subtask.place, subtask.robot
    start, carried = now.poses[item], kind_of(item).carried
    if carried is None or place not in now.poses or why_not_carry(subtask, now):
        return None
    target = now.poses[place]
    # A rack is the same from both sides: the thing turns less than a quarter.
    turn = math.pi * round((start.yaw - target.yaw) / math.pi)
    end = Pose2(target.x, target.y, target.yaw + turn)
    base = geometry.robots[robot].base
    mine, other = sorted(
        (grasp.at for grasp in carried.handles),
        key=lambda at: base.distance(start @ at),
    )
    partner = nearest_robot(
        {name: placed.base for name, placed in geometry.robots.items()},
        start @ other,
        but=robot,
    )
    if partner is None:
        return None
    hands = {robot: (start @ mine, end @ mine), partner: (start @ other, end @ other)}
    if any(geometry.margin(name, *poses) <= 0.0 for name, poses in hands.items()):
        return None
    # Each robot bears half of the weight.
    half_kg = 0.5 * now.spec.placement(item).weight_kg
    if any(geometry.robots[name].carries_kg < half_kg for name in hands):
        return None
    after = now.moved(item, end, place, f"on {place}")
    for name, support in now.supports.items():
        if support == item:
            load = end @ start.inverse() @ now.poses[name]
            after = after.moved(name, load, item, now.labels[name])
    way_m = start.distance(end) + _UP_AND_DOWN_M
    alone_s = max(geometry.duration_s(name, *poses) for name, poses in hands.items())
    return GroundedOption(
        subtask,
        GroundedSubTask(robot, subtask.primitive, *hands[robot]),
        after,
        min(geometry.quality(name, *poses) for name, poses in hands.items()),
        alone_s - _ONE_HAND_S + 1.5 * way_m / CARRY_M_S,
        theirs=GroundedSubTask(partner, subtask.primitive, *hands[partner]),
    )
