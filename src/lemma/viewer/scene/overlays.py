"""A policy's perception and the path of a hand, drawn over the table."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from lemma.core.poses import FloatArray
from lemma.policies.interfaces import Insight
from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.viz.annotate import ROBOT_INK

Point = tuple[float, float, float]

_POINTS = 96
_OVER_TABLE_M = 0.006
_MARK_M = 0.012
_MARK_HEIGHT_M = 0.09
_MARK_RGB = (150, 60, 200)
_ROLE_HEIGHT_M = 0.2


def ring(x: float, y: float, radius_m: float, every: int = 1) -> FloatArray:
    """Return a circle on the table as lines, (N, 2, 3); one in ``every`` is drawn."""
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS + 1)
    points = np.stack(
        [
            x + radius_m * np.cos(angles),
            y + radius_m * np.sin(angles),
            np.full_like(angles, _OVER_TABLE_M),
        ],
        1,
    )
    return np.stack([points[:-1], points[1:]], 1)[::every]


def draw_perceived(
    server: viser.ViserServer, instance: Instance, insight: Insight
) -> list[Any]:
    """Mark each thing that was seen, its part in the goal, and each robot's reach.

    Args:
        server: The page.
        instance: Of the robots.
        insight: Of the policy.

    Returns:
        The nodes.
    """
    nodes: list[Any] = []
    robots = zip(insight.robots, instance.scene.robots, strict=False)
    for number, (seen, placed) in enumerate(robots):
        for radius_m in seen.reach_m:
            nodes.append(
                server.scene.add_line_segments(
                    f"/perceived/robot_{number}/{len(nodes)}",
                    ring(*seen.at, radius_m, 3),
                    ROBOT_INK[placed.color][:3],
                    thickness=3.0,
                    thickness_units="screen",
                )
            )
    parts = roles(insight)
    for thing in insight.objects:
        at = (*thing.at, _MARK_HEIGHT_M)
        nodes.append(
            server.scene.add_icosphere(
                f"/perceived/{thing.name}", _MARK_M, color=_MARK_RGB, position=at
            )
        )
        told = ", ".join((entity_named(thing.name).phrase, *parts.get(thing.name, ())))
        nodes.append(
            server.scene.add_label(
                f"/perceived/{thing.name}_role",
                f"sees: {told}",
                position=(*thing.at, _ROLE_HEIGHT_M),
                anchor="bottom-center",
                font_screen_scale=0.7,
            )
        )
    return nodes


def roles(insight: Insight) -> dict[str, tuple[str, ...]]:
    """Return the parts that things have in a goal, by name of the entity."""
    found: dict[str, tuple[str, ...]] = {}
    for top, bottom in insight.goal:
        found[top] = (*found.get(top, ()), "goes on top")
        found[bottom] = (*found.get(bottom, ()), "lies below")
    return found


def draw_path(
    server: viser.ViserServer, points: Sequence[Point], rgb: tuple[int, int, int]
) -> list[Any]:
    """Draw the path of a hand.

    Args:
        server: The page.
        points: From where the hand is to where it ends [m].
        rgb: Color of its robot.

    Returns:
        The nodes.
    """
    at = np.asarray(points, np.float32)
    lines = server.scene.add_line_segments(
        "/path/lines",
        np.stack([at[:-1], at[1:]], 1),
        rgb,
        thickness=4.0,
        thickness_units="screen",
    )
    ends = server.scene.add_point_cloud(
        "/path/points", at[1:], rgb, point_size=0.02, point_shape="circle"
    )
    return [lines, ends]
