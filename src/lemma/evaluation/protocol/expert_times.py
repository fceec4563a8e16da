"""Tables of the frozen val and test splits: the expert's times, and perturbed starts.

They are in the package, ``expert_times.json``, made by ``python
scripts/expert_times.py`` through the same path as ``lemma evaluate --policy oracle``. A
policy's time is compared with the expert's, and a change of skills or physics changes
it.

A perturbed start is the same problem with everything a little elsewhere: each object is
moved by up to 3 cm and turned by up to 15 degrees. A draw counts only if every robot
reaches what it reached before and nothing else, objects keep apart and in sight, and
the expert solves it with as many sub-tasks as the task promises.
"""

import hashlib
import json
import math
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2
from lemma.core.seeding import stream
from lemma.tasks.instance import Instance

TIMES = "expert_times.json"
"""File in the package."""
TIMED_SPLITS = ("val", "test")
SHIFT_M = 0.03
"""Largest distance that an object is moved by [m]."""
TURN_RAD = math.radians(15.0)
"""Largest angle that it is turned by [rad]."""
APART_M = 0.12
"""Least distance between the middles of cubes and pads [m]."""
FROM_STICK_M = 0.09
"""Least distance of their middles from the stick [m]."""


def expert_s(
    task: str, split: str, index: int, *, perturbed_start: bool = False
) -> float | None:
    """Return the simulated time that the expert takes for an instance [s].

    Args:
        task: Name of the task.
        split: Name of the list.
        index: Number in the list.
        perturbed_start: With its objects elsewhere.

    Returns:
        The time until it says ``stop``; None for splits that are not in the table.
    """
    if split not in TIMED_SPLITS:
        return None
    times = _table()[split][task]
    found: float = times["perturbed_s" if perturbed_start else "elapsed_s"][index]
    return found


def perturbed_start(instance: Instance) -> Instance:
    """Return a frozen instance with its objects a little elsewhere.

    Raises:
        InvalidConfigError: Its split has no perturbed starts.
    """
    if instance.split not in TIMED_SPLITS:
        raise InvalidConfigError(
            f"Split {instance.split!r} has no perturbed starts; {TIMED_SPLITS} have."
        )
    draw = _table()[instance.split][instance.task]["draw"][instance.index]
    return perturbed(instance, draw)


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


def times_sha256() -> str:
    """Return the SHA-256 of the table."""
    return hashlib.sha256(_bytes()).hexdigest()


@cache
def _bytes() -> bytes:
    return (files("lemma.evaluation.protocol") / TIMES).read_bytes()


@cache
def _table() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(_bytes())
    return table
