"""Statistics by which policies of LeRobot normalize states and actions.

LeRobot divides by the standard deviation plus 1e-8. In demonstrations an arm without
a task never moves; in use it does, by micrometres. Divided by 1e-8 these are hundreds,
far from all inputs of the training.
"""

from collections.abc import Mapping
from typing import Any

SMALLEST_STD = 0.01
"""Smallest standard deviation for normalization [m, rad, 1]."""
NUMBERS = ("state", "action")
"""Ends of the names of features that a policy normalizes as numbers."""
_LOWER, _UPPER = ("min", "q01", "q10"), ("max", "q90", "q99")


def widened(stats: Mapping[str, Any]) -> dict[str, Any]:
    """Return statistics in which no number of a state or action is constant.

    Args:
        stats: ``meta/stats.json`` of a LeRobotDataset: lists by name of the statistic
            and of the feature.

    Returns:
        The same, with standard deviations of at least :data:`SMALLEST_STD`, and minima,
        maxima and outer quantiles at least as far from the mean.
    """
    return {
        name: _widened(feature) if name.endswith(NUMBERS) else feature
        for name, feature in stats.items()
    }


def _widened(feature: Mapping[str, list[float]]) -> dict[str, list[float]]:
    found = dict(feature)
    mean = found["mean"]
    found["std"] = [max(one, SMALLEST_STD) for one in found["std"]]
    for names, choose, side in ((_LOWER, min, -1), (_UPPER, max, 1)):
        for name in (each for each in names if each in found):
            found[name] = [
                choose(one, center + side * SMALLEST_STD)
                for one, center in zip(found[name], mean, strict=True)
            ]
    return found
