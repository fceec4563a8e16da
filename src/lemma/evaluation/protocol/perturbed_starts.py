"""Perturbed starts: the same problem, with everything a little elsewhere.

Each object is moved by up to 3 cm and turned by up to 15 degrees. A draw counts only if
every robot reaches what it reached before and nothing else, objects keep apart and in
sight, and the expert solves it with as many sub-tasks as the task promises. Which draw
counts is frozen with the expert's times
(:mod:`lemma.evaluation.protocol.expert_times`);
``scripts/expert_times.py`` chooses it.
"""

import math
from dataclasses import replace

from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.tasks.instance import Instance

SHIFT_M = 0.03
"""Largest distance that an object is moved by [m]."""
TURN_RAD = math.radians(15.0)
"""Largest angle that it is turned by [rad]."""
APART_M = 0.12
"""Least distance between the middles of cubes and pads [m]."""
FROM_STICK_M = 0.09
"""Least distance of their middles from the stick [m]."""


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
