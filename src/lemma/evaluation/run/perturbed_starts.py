"""Perturbed starts: the same problem, with everything a little elsewhere.

Each object is moved by up to 3 cm and turned by up to 15 degrees. A draw counts only if
every robot reaches what it reached before and nothing else, objects keep apart and in
sight, and the expert solves it with as many sub-tasks as the task promises. Which draw
counts is frozen with the expert's times (:mod:`lemma.evaluation.run.expert_times`).
"""

import math
from dataclasses import replace
from itertools import combinations

from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.scene.build import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.scene.camera_mounts import camera_sees
from lemma.scene.objects.entity import STICK
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M
from lemma.scene.spec import ObjectPlacement, SceneSpec
from lemma.tasks.drags import stick_gap
from lemma.tasks.instance import Instance
from lemma.tasks.placement import Board

SHIFT_M = 0.03
"""Largest distance that an object is moved by [m]."""
TURN_RAD = math.radians(15.0)
"""Largest angle that it is turned by [rad]."""
APART_M = 0.12
"""Least distance between the middles of cubes and pads [m]."""
FROM_STICK_M = 0.09
"""Least distance of their middles from the stick [m]."""
_EDGE_M = 0.03


def perturbed(instance: Instance, draw: int) -> Instance:
    """Return an instance with its objects elsewhere; all else is the same.

    Args:
        instance: Any.
        draw: Number of the draw; the same gives the same.
    """
    rng = stream(instance.key, "perturbed start", draw)
    moved = []
    for placed in instance.scene.objects:
        # Uniform in a disc.
        radius = SHIFT_M * math.sqrt(rng.random())
        bearing = rng.uniform(-math.pi, math.pi)
        turn = rng.uniform(-TURN_RAD, TURN_RAD)
        pose = Pose2(
            placed.pose.x + radius * math.cos(bearing),
            placed.pose.y + radius * math.sin(bearing),
            placed.pose.yaw + turn,
        )
        moved.append(replace(placed, pose=pose.rounded()))
    scene = replace(instance.scene, objects=tuple(moved))
    return replace(instance, scene=scene)


def is_alike(scene: SceneSpec, original: SceneSpec) -> bool:
    """Whether a scene poses the same problem as the one that it was made of."""
    board = Board(scene.robots, stream("unused"))
    pairs = zip(scene.objects, original.objects, strict=True)
    return all(
        _is_reached(board, now) == _is_reached(board, before)
        and any(camera_sees(robot, now.pose.x, now.pose.y) for robot in scene.robots)
        and _is_on_table(now)
        for now, before in pairs
    ) and all(
        _are_apart(one, another) for one, another in combinations(scene.objects, 2)
    )


def _is_reached(board: Board, placed: ObjectPlacement) -> list[tuple[bool, bool]]:
    """Return for each robot whether it surely reaches, and surely does not."""
    robots = range(len(board.robots))
    return [
        (board.reaches(r, placed.pose), board.cannot(r, placed.pose)) for r in robots
    ]


def _is_on_table(placed: ObjectPlacement) -> bool:
    ends = [placed.pose]
    if placed.name == STICK:
        ends.append(placed.pose @ Pose2(HANDLE_LENGTH_M, 0.0))
        ends.append(placed.pose @ Pose2(HANDLE_LENGTH_M, HOOK_LENGTH_M))
    return all(
        abs(end.x) < TABLE_HALF_X_M - _EDGE_M and abs(end.y) < TABLE_HALF_Y_M - _EDGE_M
        for end in ends
    )


def _are_apart(one: ObjectPlacement, another: ObjectPlacement) -> bool:
    if one.name == STICK:
        one, another = another, one
    if another.name == STICK:
        return stick_gap(another.pose, one.pose.x, one.pose.y) >= FROM_STICK_M
    return one.pose.distance(another.pose) >= APART_M
