"""What the maker publishes of its arms, where benchmark version v1 has other numbers.

Version v1 has the masses and limits of an old ROS description (see
:mod:`lemma.robots.ur.arms`) and keeps them, so that its data stay what they are. These
are for the next version, which makes its arms with :func:`with_published`.

Source: Universal Robots' own description for ROS 2,
https://github.com/UniversalRobots/Universal_Robots_ROS2_Description, in the folder
``config`` of each arm ``physical_parameters.yaml`` (commit 3426d67) for masses, and
``joint_limits.yaml`` (commit 8ef39b3) for the rest. The latter quotes the user manuals
of UR5 and UR10 (CB3, version 3.13) for speeds, and the maker's article "Max. joint
torques" of June 2020.
"""

import math
from dataclasses import dataclass, replace

from lemma.core.errors import UnknownNameError
from lemma.robots.ur.arms import ArmSpec, Six

_HALF_TURN = math.pi
_THIRD_OF_A_TURN = 2.0 * math.pi / 3.0


@dataclass(frozen=True, kw_only=True)
class PublishedFigures:
    """Masses and limits of one arm, as its maker publishes them."""

    link_masses: Six
    """Shoulder to wrist 3 [kg]."""
    effort_limits: Six
    """Largest joint torques [N m]."""
    velocity_limits: Six
    """Largest joint speeds [rad/s]: 120 or 180 degrees per second."""


PUBLISHED = {
    "ur5": PublishedFigures(
        link_masses=(3.7, 8.393, 2.33, 1.219, 1.219, 0.1879),
        effort_limits=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
        velocity_limits=(_HALF_TURN,) * 6,
    ),
    "ur10": PublishedFigures(
        link_masses=(7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
        effort_limits=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
        velocity_limits=(
            *(_THIRD_OF_A_TURN, _THIRD_OF_A_TURN, _HALF_TURN),
            *(_HALF_TURN, _HALF_TURN, _HALF_TURN),
        ),
    ),
}
"""By name of the arm."""


def with_published(arm: ArmSpec) -> ArmSpec:
    """Return an arm with the masses and limits that its maker publishes.

    Raises:
        UnknownNameError: They are not known here.
    """
    if arm.name not in PUBLISHED:
        raise UnknownNameError("arm with published figures", arm.name, PUBLISHED)
    found = PUBLISHED[arm.name]
    return replace(
        arm,
        link_masses=found.link_masses,
        effort_limits=found.effort_limits,
        velocity_limits=found.velocity_limits,
    )
