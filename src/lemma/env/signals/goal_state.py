"""A small state vector for learners: the relation of each hand to the goal.

It describes the first conjunct of the goal that does not hold yet, or the last one if
all hold: the position of its object and of the place, relative to each hand. Each robot
has its own numbers, in the frame of its hand: *forward* is horizontally away from the
axis of the robot's base, *left* is to the left of that, *up* is up. This frame makes
the numbers invariant to rotation about the base.

It is computed from the true state. It does not include the stick, so *poke* and *hook*
cannot be learned from it alone.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lemma.core.poses import FloatArray
from lemma.env.episode import Episode
from lemma.scene.objects.entity import kind_of
from lemma.scene.scene import Scene
from lemma.tasks.goal import LIFTED_M, Goal, Lifted, On, Predicate, Reached

NUMBERS = (
    "reach",
    "height",
    "tilt_forward",
    "tilt_left",
    "opening",
    "holds",
    "object_forward",
    "object_left",
    "object_up",
    "object_turn",
    "place_forward",
    "place_left",
    "place_up",
)
"""The numbers of one robot.

``reach``: distance of the tool centre point from the axis of the base [m].
``height``: its height above the table [m].
``tilt_forward``, ``tilt_left``: horizontal part of the unit vector along which the
gripper points; zeros when it points down.
``opening``: distance between the fingers [m].
``holds``: 1 if both of them touch the object, else 0.
``object_forward``, ``object_left``, ``object_up``: from the tool centre point to the
object's grasp position [m].
``object_turn``: by how much the gripper is to be turned about the vertical,
counterclockwise seen from above, for its fingers to close along the object [rad].
``place_forward``, ``place_left``, ``place_up``: from the object to its place [m]: on
the goal's bottom; the missing height, if it is to be lifted; zeros if a hand is to be
held over it.
"""


def goal_state_names(robots: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the numbers of a goal state: ``"robot_0.reach"``, ..."""
    return tuple(f"{robot}.{number}" for robot in robots for number in NUMBERS)


def goal_state(episode: Episode, robots: Sequence[str]) -> NDArray[np.float32]:
    """Return the goal state of some robots, (13 n,).

    Args:
        episode: The episode.
        robots: Names of the robots.

    Returns:
        The numbers of :func:`goal_state_names`.
    """
    simulation = episode.simulation
    scene, goal = simulation.scene, episode.instance.goal
    predicate = _present(goal, scene)
    name = predicate.bottom if isinstance(predicate, Reached) else predicate.top
    held = simulation.held()
    (*at, yaw), turn_rad = grasp_of(name, scene)
    way = np.subtract(place_of(predicate, scene), scene.position(name))
    rows = []
    for robot in robots:
        arm = simulation.arms[robot]
        tcp, base = arm.tcp_pose(), arm.robot.world_from_base
        x, y = (tcp[:2, 3] - base[:2, 3]).tolist()
        reach = math.hypot(x, y)
        forward = (x / reach, y / reach) if reach else base[:2, 0].tolist()
        turn = yaw - math.atan2(tcp[1, 0], tcp[0, 0])
        rows += [
            *(reach, tcp[2, 3], *_seen(tcp[:, 2], forward)[:2]),
            *(scene.opening_m(arm.robot), float(held.get(robot) == name)),
            *_seen(np.subtract(at, tcp[:3, 3]), forward),
            math.remainder(turn, turn_rad) if turn_rad else 0.0,
            *_seen(way, forward),
        ]
    return np.array(rows, np.float32)


def grasp_of(
    name: str, scene: Scene
) -> tuple[tuple[float, float, float, float], float]:
    """Return the grasp pose of an object.

    Returns:
        x, y, z and yaw [m, rad]; and the angle of its rotational symmetry about the
        vertical, 0 if it is symmetric under every rotation [rad].
    """
    kind, (x, y, z) = kind_of(name), scene.position(name)
    target = scene.pose2(name)
    if kind.grasp is None:
        return (x, y, z, target.yaw), 0.0
    target = target @ kind.grasp.at
    height_m = z + kind.grasp.height_m - kind.origin_m
    return (target.x, target.y, height_m, target.yaw), kind.grasp.turn_rad


def place_of(predicate: Predicate, scene: Scene) -> tuple[float, float, float]:
    """Return the target position of an object's frame in a conjunct of a goal [m].

    The target is on the bottom; at lifting height above the present position; or the
    present position, if a hand is to be held over it.
    """
    if isinstance(predicate, On):
        x, y, z = scene.position(predicate.bottom)
        upper, lower = kind_of(predicate.top), kind_of(predicate.bottom)
        return (x, y, z + lower.top_m + upper.origin_m)
    if isinstance(predicate, Lifted):
        x, y, _ = scene.position(predicate.top)
        return (x, y, kind_of(predicate.top).origin_m + LIFTED_M)
    x, y, z = scene.position(predicate.bottom)
    return (x, y, z)


def _present(goal: Goal, scene: Scene) -> Predicate:
    """Return the first conjunct of a goal that does not hold, or the last."""
    for predicate in goal.conjuncts[:-1]:
        if not predicate.holds(scene):
            return predicate
    return goal.conjuncts[-1]


def _seen(vector: FloatArray, forward: Sequence[float]) -> tuple[float, float, float]:
    """Return a world vector as forward, left and up."""
    x, y, z = vector[:3].tolist()
    a, b = forward
    return (a * x + b * y, a * y - b * x, z)
