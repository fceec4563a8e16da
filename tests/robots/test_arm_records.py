"""Records of arms are checked; what the maker publishes lies ready for version v2."""

import math
from dataclasses import replace
from typing import Any

import mujoco
import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.robots.ur.arms import ARMS
from lemma.robots.ur.build import add_arm
from lemma.robots.ur.published import PUBLISHED, with_published
from lemma.tasks.instance import BENCHMARK_VERSION


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


def test_published_masses_and_limits() -> None:
    assert PUBLISHED["ur10"].link_masses == (7.1, 12.7, 4.27, 2.0, 2.0, 0.365)
    assert PUBLISHED["ur10"].effort_limits == (330, 330, 150, 56, 56, 56)
    assert PUBLISHED["ur10"].velocity_limits == pytest.approx(
        (2.094, 2.094, 3.142, 3.142, 3.142, 3.142), abs=5e-4
    )
    assert PUBLISHED["ur5"].link_masses == (3.7, 8.393, 2.33, 1.219, 1.219, 0.1879)
    assert PUBLISHED["ur5"].effort_limits == (150, 150, 150, 28, 28, 28)
    assert PUBLISHED["ur5"].velocity_limits == pytest.approx((3.142,) * 6, abs=5e-4)
    assert sum(PUBLISHED["ur10"].link_masses) == pytest.approx(28.435)


def test_version_1_has_its_own() -> None:
    # Together with the benchmark's version these numbers may change.
    assert BENCHMARK_VERSION == "v1"
    assert ARMS["ur5"].link_masses == (3.7, 8.393, 2.275, 1.219, 1.219, 0.1879)
    assert ARMS["ur10"].link_masses == (7.778, 12.93, 3.87, 1.96, 1.96, 0.202)
    assert ARMS["ur10"].effort_limits == (330, 330, 150, 54, 54, 54)
    assert ARMS["ur5"].velocity_limits == (3.15, 3.15, 3.15, 3.2, 3.2, 3.2)
    assert ARMS["ur10"].velocity_limits == (2.16, 2.16, 3.15, 3.2, 3.2, 3.2)


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_published_arms_can_be_built(name: str) -> None:
    arm = with_published(ARMS[name])
    spec = mujoco.MjSpec()
    add_arm(spec, arm, "robot_0", Pose2(0.0, 0.0), "white")
    model = spec.compile()
    assert model.body("robot_0/forearm").mass == pytest.approx(arm.link_masses[2])
    assert (
        replace(
            arm,
            link_masses=ARMS[name].link_masses,
            effort_limits=ARMS[name].effort_limits,
            velocity_limits=ARMS[name].velocity_limits,
        )
        == (ARMS[name])
    )


def test_figures_of_other_arms_are_not_invented() -> None:
    with pytest.raises(UnknownNameError, match="ur16e"):
        with_published(replace(ARMS["ur10"], name="ur16e"))
