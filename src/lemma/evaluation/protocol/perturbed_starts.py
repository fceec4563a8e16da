"""Perturbed starts: the same instances with slightly different poses of objects.

Each object is moved by up to 3 cm and turned by up to 15 degrees. A draw is valid only
if every robot reaches the same objects as before, objects keep their distance and are
visible, and the expert solves it with the task's number of sub-tasks. The number of the
chosen draw is frozen with the expert's times
(:mod:`lemma.evaluation.protocol.expert_times`); ``scripts/expert_times.py`` chooses it.
"""

import math
from dataclasses import replace

from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.tasks.instance import Instance

SHIFT_M = 0.03
"""Largest shift of an object [m]."""
TURN_RAD = math.radians(15.0)
"""Largest rotation of an object [rad]."""
APART_M = 0.12
"""Smallest distance between the centers of cubes and pads [m]."""
FROM_STICK_M = 0.09
"""Smallest distance of their centers from the stick [m]."""


def perturbed(instance: Instance, draw: int) -> Instance:
    """Return an instance with perturbed poses of its objects.

    Args:
        instance: The instance.
        draw: Number of the draw, which determines the perturbation.
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
