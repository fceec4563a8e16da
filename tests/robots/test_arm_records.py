"""Records of arms are checked, and hold what the maker publishes."""

import math
from dataclasses import replace
from typing import Any

import pytest

from lemma.core.errors import InvalidConfigError
from lemma.robots.ur.arms import ARMS


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"link_masses": (1.0,) * 7}, "link_masses .* 6 numbers, one per joint"),
        ({"stiffness": (1.0,) * 5}, "stiffness .* 6 numbers"),
        ({"velocity_limits": 3.14}, "velocity_limits .* 6 numbers"),
        ({"joint_range": ()}, "joint_range .* 6 numbers"),
        ({"d1": (0.1,)}, "d1 .* one number"),
        ({"a2": math.nan}, "a2 .* finite and positive"),
        ({"a2": -0.425}, "a2 .* finite and positive"),
        ({"armature": (1.0, 1.0, 1.0, 1.0, 1.0, 0.0)}, "armature .* positive"),
        ({"payload_kg": "five"}, "payload_kg .* finite"),
        ({"elbow_offset": math.inf}, "elbow_offset .* finite"),
        ({"name": "UR 5"}, "cannot name an arm"),
    ],
)
def test_a_record_that_is_none_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        replace(ARMS["ur5"], **wrong)


def test_an_offset_may_be_negative() -> None:
    assert replace(ARMS["ur5"], elbow_offset=-0.2).elbow_offset == -0.2


def test_masses_and_limits_are_the_makers() -> None:
    ur5, ur10 = ARMS["ur5"], ARMS["ur10"]
    assert ur10.link_masses == (7.1, 12.7, 4.27, 2.0, 2.0, 0.365)
    assert ur10.effort_limits == (330, 330, 150, 56, 56, 56)
    assert ur10.velocity_limits == pytest.approx(
        (2.094, 2.094, 3.142, 3.142, 3.142, 3.142), abs=5e-4
    )
    assert ur5.link_masses == (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879)
    assert ur5.effort_limits == (150, 150, 150, 28, 28, 28)
    assert ur5.velocity_limits == pytest.approx((3.142,) * 6, abs=5e-4)
    assert sum(ur10.link_masses) == pytest.approx(28.435)
