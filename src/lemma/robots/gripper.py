"""Dimensions of the gripper, which is similar to a Hand-E with a larger opening.

:mod:`lemma.robots.gripper_body` builds its bodies. This module does not import MuJoCo,
so that code without a simulator uses the same dimensions.
"""

FINGER_OPENING_M = 0.1
"""Distance between the pads when fully open."""
TCP_OFFSET_M = 0.12
"""Distance of the tool centre point from the flange."""
FINGERTIP_BEYOND_TCP_M = 0.012
"""Distance of the fingertips beyond the tool centre point."""
FINGER_WIDTH_M = 0.022
"""Extent of a finger across the closing direction."""
FINGER_THICKNESS_M = 0.016
"""Extent of a finger along the closing direction."""
FINGER_CENTER_M = 0.059
"""Distance of the centre of an open finger from the tool centre point."""
FINGER_DISC_M = 0.014
"""Radius of a disc around that centre that just covers the finger."""
PALM_BEYOND_FLANGE_M = 0.072
"""Distance of the palm's end from the flange; a deeper object collides with it."""
PALM_ABOVE_TCP_M = TCP_OFFSET_M - PALM_BEYOND_FLANGE_M
"""Free height between the fingers above the tool centre point."""
GRIP_FORCE_N = 50.0
"""Largest force of each finger (a Hand-E: 20 to 185 N)."""
SKIN_M = 0.001
"""Contact margin of the pads: contacts begin at this distance from their surface."""
MASS_KG = 1.0
"""Mass of palm and fingers (a Hand-E: 1.07 kg)."""
