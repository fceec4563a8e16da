"""Which cases of a test `make test` leaves to `make test-all`."""

from collections.abc import Iterable
from typing import Any

import pytest

MODES = ("ee_pose", "delta_ee_pose_rot6d", "joint_velocity", "joint_torque")
"""Controls that quick tests go through: a pose, a difference, a speed, a torque."""


def slow_but(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """Return all cases for ``pytest.mark.parametrize``, slow but for some.

    Args:
        cases: All of them; a tuple is one case of several arguments.
        quick: Those that are not slow.
    """
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=() if case in quick else pytest.mark.slow,
        )
        for case in cases
    ]
