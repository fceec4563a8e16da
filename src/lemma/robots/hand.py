"""Hands: how hard the fingers of a robot close, and what it can carry for that.

Plain numbers, so that code without a simulator reads the same ones.
"""

import math
from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry
from lemma.robots.gripper import GRIP_FORCE_N, MASS_KG
from lemma.robots.ur.arms import ARMS

RUBBER_FRICTION = (1.2, 0.02, 0.0001)
"""Sliding, torsional [m] and rolling [m] friction of the fingers' pads."""
RUBBER_SOLREF = (-10000.0, -280.0)
"""Stiffness and damping of their contacts [1/s2, 1/s]."""
RUBBER_SOLIMP = (0.998, 0.998, 0.001, 0.5, 2.0)
"""Impedance of their contacts."""
_GRAVITY_M_S2 = 9.81
_SAFETY = 2.0
"""Friction of a grasp over the weight of the largest load. An arm that turns needs more
friction than one at rest."""


@dataclass(frozen=True, slots=True)
class Hand:
    """A gripper of the one shape that all robots have, and of some force."""

    name: str
    """A lower-case word, as prompts and pages write it."""
    force_n: float
    """Largest force of each finger [N]."""

    def __post_init__(self) -> None:
        """Check the force.

        Raises:
            InvalidConfigError: It is not positive.
        """
        if not 0.0 < self.force_n < math.inf:
            raise InvalidConfigError(
                f"A hand cannot have force_n={self.force_n}. Valid: a positive number."
            )

    @property
    def carries_kg(self) -> float:
        """Largest mass that it carries with two pads [kg]."""
        return 2.0 * RUBBER_FRICTION[0] * self.force_n / (_SAFETY * _GRAVITY_M_S2)


HANDS: Registry[Hand] = Registry("hand", Hand)
"""Every hand that a robot may have, by name."""
STANDARD = HANDS.add("standard", Hand("standard", GRIP_FORCE_N)).name
"""Name of the hand that robots have where nothing else is said."""
WEAK = HANDS.add("weak", Hand("weak", 8.0)).name
"""Name of a hand that carries things of wood, and lifts nothing of metal."""


def carries_kg(arm: str, hand: str) -> float:
    """Return the largest mass that a robot may carry [kg].

    The friction of its hand and the payload of its arm limit it; the hand itself counts
    as payload.

    Args:
        arm: A name in ``ARMS``.
        hand: A name in :data:`HANDS`.
    """
    return min(HANDS[hand].carries_kg, ARMS[arm].payload_kg - MASS_KG)
