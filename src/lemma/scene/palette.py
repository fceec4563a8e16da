"""The five colours of cubes and pads, the stick's, and the room's."""

from lemma.core.registry import Registry

Rgba = tuple[float, float, float, float]

OBJECT_COLOURS: Registry[Rgba] = Registry("object colour")
"""Colours of cubes and pads."""

OBJECT_COLOURS.add("pink", (0.95, 0.45, 0.68, 1.0))
OBJECT_COLOURS.add("red", (0.80, 0.10, 0.10, 1.0))
OBJECT_COLOURS.add("white", (0.95, 0.95, 0.93, 1.0))
OBJECT_COLOURS.add("blue", (0.10, 0.28, 0.78, 1.0))
OBJECT_COLOURS.add("green", (0.10, 0.55, 0.22, 1.0))

STICK: Rgba = (0.96, 0.76, 0.12, 1.0)
TABLE: Rgba = (0.42, 0.40, 0.38, 1.0)
TABLE_EDGE: Rgba = (0.30, 0.28, 0.27, 1.0)
FLOOR: Rgba = (0.72, 0.73, 0.75, 1.0)
