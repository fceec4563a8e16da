"""Sizes of the gripper: a two-finger one in the manner of a Hand-E, wider open.

:mod:`lemma.robots.gripper_body` builds it. Plain numbers, so that code without a
simulator reads the same ones.
"""

FINGER_OPENING_M = 0.1
"""Distance between the pads when fully open."""
TCP_OFFSET_M = 0.12
"""Distance of the tool centre point from the flange."""
FINGERTIP_BEYOND_TCP_M = 0.012
"""How far the fingertips reach beyond the tool centre point."""
FINGER_WIDTH_M = 0.022
"""Extent of a finger across the closing direction."""
FINGER_THICKNESS_M = 0.016
"""Extent of a finger along the closing direction."""
FINGER_CENTER_M = 0.059
"""Distance of the middle of an open finger from the tool centre point."""
FINGER_DISC_M = 0.014
"""Radius of a disc around it that covers the finger, with little to spare."""
PALM_BEYOND_FLANGE_M = 0.072
"""Where the palm ends: an object deeper than this collides with it."""
PALM_ABOVE_TCP_M = TCP_OFFSET_M - PALM_BEYOND_FLANGE_M
"""How deep a thing may stand between the fingers, from the tool centre point up."""
GRIP_FORCE_N = 50.0
"""Largest force of each finger (a Hand-E: 20 to 185 N)."""
SKIN_M = 0.001
"""Depth of the soft skin in which the pads' contacts begin: nothing sinks deeper."""
MASS_KG = 1.0
"""Mass of palm and fingers (a Hand-E: 1.07 kg)."""
