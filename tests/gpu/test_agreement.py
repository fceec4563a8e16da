"""The expert's commands have the same effect, and equal states are judged alike."""

import pytest

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed; `make test-warp` installs it"
)
pytest.importorskip("torch")

from measure_worlds import agreement


def test_the_experts_commands_end_where_they_end_on_the_cpu() -> None:
    found = agreement("lift_fixed", 2, device="cpu")
    assert found["success"] == (True, 1.0)
    for median_mm, share in found["objects"].values():
        assert median_mm < 2.0
        assert share == 1.0
    # States are of single precision, and contacts those of the state itself.
    assert found["potential"][0] < 1e-4
    assert found["goal_state"][0] < 1e-3
