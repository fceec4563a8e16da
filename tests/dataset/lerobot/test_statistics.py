"""Statistics for normalization: nothing is divided by almost zero."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lemma.dataset.lerobot.statistics import SMALLEST_STD, widened

NUMBERS = ("observation.state", "observation.environment_state", "robot_0.action")
EPS = 1e-8
"""LeRobot adds it to standard deviations."""
columns = st.lists(
    st.tuples(st.floats(-2.0, 2.0), st.sampled_from([0.0, 1e-7, 1e-3, 0.5])),
    min_size=1,
    max_size=4,
)


@given(columns)
def test_a_micrometre_is_small_and_what_varies_stays(
    made: list[tuple[float, float]],
) -> None:
    rows = np.array([[c - d for c, d in made], [c + d for c, d in made]], np.float32)
    mean = rows.mean(0)
    plain = {
        "mean": mean.tolist(),
        "std": rows.std(0).tolist(),
        "min": rows.min(0).tolist(),
        "max": rows.max(0).tolist(),
        "q01": rows.min(0).tolist(),
        "q99": rows.max(0).tolist(),
        "count": [2],
    }
    stats = {name: plain for name in NUMBERS}
    images = {"observation.images.wrist": {**plain, "std": [0.0]}}
    found = widened({**stats, **images})
    assert found["observation.images.wrist"] == images["observation.images.wrist"]
    for name in NUMBERS:
        one = {key: np.array(value) for key, value in found[name].items()}
        moved = rows + 1e-6
        assert (np.abs((moved - mean) / (one["std"] + EPS)) < 1.1).all()
        for low, high in (("min", "max"), ("q01", "q99")):
            width = one[high] - one[low]
            assert (width >= 1.9 * SMALLEST_STD).all()
            assert (one[low] <= rows.min(0)).all()
            assert (one[high] >= rows.max(0)).all()
        varied = rows.std(0) > SMALLEST_STD
        assert np.array_equal(one["std"][varied], np.array(plain["std"])[varied])
