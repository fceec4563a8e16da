"""Statistics of success: what a rate of so few episodes can say."""

import math

Z_95 = 1.959963984540054
"""Two-sided quantile of the normal distribution for 95 %."""


def wilson_interval(
    successes: int, trials: int, z: float = Z_95
) -> tuple[float, float]:
    """Return the Wilson score interval of a success rate.

    Args:
        successes: Of the trials.
        trials: At least one.
        z: Quantile of the normal distribution; 1.96 gives 95 %.

    Raises:
        ValueError: No trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes} successes in {trials} trials.")
    rate = successes / trials
    scale = 1.0 + z * z / trials
    centre = (rate + z * z / (2.0 * trials)) / scale
    variance = rate * (1.0 - rate) / trials + z * z / (4.0 * trials * trials)
    half = z * math.sqrt(variance) / scale
    return max(0.0, centre - half), min(1.0, centre + half)
