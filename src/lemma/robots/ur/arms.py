"""Parameters of the arms of the UR family.

Lengths, masses and limits are those of Universal Robots' description for ROS 2,
https://github.com/UniversalRobots/Universal_Robots_ROS2_Description, in the folder
``config`` of each arm: masses from ``physical_parameters.yaml`` (commit 3426d67),
limits from ``joint_limits.yaml`` (commit 8ef39b3). The latter cites the user manuals of
UR5 and UR10 (CB3, version 3.13) for speeds, and Universal Robots' article "Max. joint
torques" of June 2020 for torques. Inertias are those of solid cylinders of these
masses. Radii are measured on pictures. Servo gains are chosen for this simulation.
"""

import math
import re
from dataclasses import dataclass, fields

import numpy as np

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray
from lemma.core.registry import Registry

_HALF_TURN = math.pi
_THIRD_OF_A_TURN = 2.0 * math.pi / 3.0

Six = tuple[float, float, float, float, float, float]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Names of the joints, from the base to the flange."""
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""Names of the links; joint i moves link i."""


@dataclass(frozen=True, kw_only=True)
class ArmSpec:
    """Parameters of one arm.

    Raises:
        InvalidConfigError: The name is no lower-case word, or a parameter has the wrong
            number of values, is not finite, or is negative where it must not be.
    """

    name: str
    """Name in the registry, a lower-case word such as ``"ur16e"``."""
    d1: float
    """Height of the shoulder above the base [m]."""
    a2: float
    """Length of the upper arm [m]."""
    a3: float
    """Length of the forearm [m]."""
    d4: float
    """Offset of wrist 1 along the shoulder axis [m]."""
    d5: float
    """Offset of wrist 2 along the axis of joint 5 [m]."""
    d6: float
    """Offset of the flange along the axis of joint 6 [m]."""
    shoulder_offset: float
    """Offset of the upper arm's tube along the shoulder axis [m]."""
    elbow_offset: float
    """Offset from the upper arm's tube to the forearm's tube [m]; negative is towards
    the base."""
    link_masses: Six
    """Masses, shoulder to wrist 3 [kg]."""
    effort_limits: Six
    """Largest joint torques [N m]."""
    velocity_limits: Six
    """Largest joint speeds [rad/s]."""
    payload_kg: float
    """Payload of the arm, gripper included."""
    shoulder_radius: float
    """Radius of the shoulder's housings [m]."""
    elbow_radius: float
    """Radius of the elbow's housings [m]."""
    wrist_radius: float
    """Radius of the wrists' housings [m]."""
    upper_tube_radius: float
    """Radius of the upper arm's tube [m]."""
    forearm_tube_radius: float
    """Radius of the forearm's tube [m]."""
    stiffness: Six
    """Servo gains on position [N m/rad]."""
    lag_s: float
    """Lag of the servos behind a moving reference: velocity gain over position gain.

    It is the same for all joints, so that the lag does not change the shape of a path.
    """
    armature: Six
    """Reflected inertias of the rotors [kg m2]."""
    joint_range: Six = (math.tau, math.tau, math.pi, math.tau, math.tau, math.tau)
    """Joint limits, symmetric about zero [rad]."""

    def __post_init__(self) -> None:
        """Check all parameters."""
        if not re.fullmatch(r"[a-z][a-z0-9_]*", str(self.name)):
            raise InvalidConfigError(
                f"{self.name!r} cannot name an arm. Use a lower-case word: 'ur16e'."
            )
        for field in fields(self)[1:]:
            self._check(field.name, 6 if field.type is Six else 1)

    def _check(self, name: str, count: int) -> None:
        value = getattr(self, name)
        wanted = "one number" if count == 1 else f"{count} numbers, one per joint"
        numbers = (value,) if count == 1 else value
        if not isinstance(numbers, list | tuple) or len(numbers) != count:
            raise InvalidConfigError(
                f"{name} of arm {self.name!r} is {value!r}, but must be {wanted}: arms "
                f"here have the joints {', '.join(JOINTS)}."
            )
        signed = name in ("shoulder_offset", "elbow_offset")
        for number in numbers:
            real = isinstance(number, int | float) and math.isfinite(number)
            if not real or not (signed or number > 0.0):
                raise InvalidConfigError(
                    f"{name} of arm {self.name!r} is {value!r}. It must be {wanted}, "
                    f"finite{'' if signed else ' and positive'}."
                )

    @property
    def dh(self) -> FloatArray:
        """Return ``[d1, a2, a3, d4, d5, d6]``, shape (6,) [m]."""
        return np.array([self.d1, self.a2, self.a3, self.d4, self.d5, self.d6])

    @property
    def damping(self) -> tuple[float, ...]:
        """Servo gains on velocity, one per joint [N m s/rad]."""
        return tuple(self.lag_s * stiffness for stiffness in self.stiffness)


ARMS: Registry[ArmSpec] = Registry("arm", ArmSpec)
ARMS.add(
    "ur5",
    ArmSpec(
        name="ur5",
        d1=0.089159,
        a2=0.425,
        a3=0.39225,
        d4=0.10915,
        d5=0.09465,
        d6=0.0823,
        shoulder_offset=0.13585,
        elbow_offset=-0.1197,
        link_masses=(3.7, 8.393, 2.33, 1.219, 1.219, 0.1879),
        effort_limits=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
        velocity_limits=(_HALF_TURN,) * 6,
        payload_kg=5.0,
        shoulder_radius=0.060,
        elbow_radius=0.057,
        wrist_radius=0.041,
        upper_tube_radius=0.047,
        forearm_tube_radius=0.036,
        stiffness=(30000.0, 30000.0, 20000.0, 4000.0, 4000.0, 4000.0),
        lag_s=0.025,
        armature=(4.2, 4.2, 2.8, 0.56, 0.56, 0.56),
    ),
)
ARMS.add(
    "ur10",
    ArmSpec(
        name="ur10",
        d1=0.1273,
        a2=0.612,
        a3=0.5723,
        d4=0.163941,
        d5=0.1157,
        d6=0.0922,
        shoulder_offset=0.220941,
        elbow_offset=-0.1719,
        link_masses=(7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
        effort_limits=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
        velocity_limits=(*(_THIRD_OF_A_TURN,) * 2, *(_HALF_TURN,) * 4),
        payload_kg=10.0,
        shoulder_radius=0.078,
        elbow_radius=0.065,
        wrist_radius=0.048,
        upper_tube_radius=0.056,
        forearm_tube_radius=0.043,
        stiffness=(60000.0, 60000.0, 30000.0, 6000.0, 6000.0, 6000.0),
        lag_s=0.028,
        armature=(9.4, 9.4, 4.7, 0.94, 0.94, 0.94),
    ),
)
