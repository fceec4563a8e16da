"""The five colors of cubes and pads, the stick's, and the room's."""

from lemma.core.registry import Registry

Rgba = tuple[float, float, float, float]

OBJECT_COLORS: Registry[Rgba] = Registry("object color")
"""Colors of cubes and pads."""

OBJECT_COLORS.add("pink", (0.95, 0.45, 0.68, 1.0))
OBJECT_COLORS.add("red", (0.80, 0.10, 0.10, 1.0))
OBJECT_COLORS.add("white", (0.95, 0.95, 0.93, 1.0))
OBJECT_COLORS.add("blue", (0.10, 0.28, 0.78, 1.0))
OBJECT_COLORS.add("green", (0.10, 0.55, 0.22, 1.0))

STICK: Rgba = (0.96, 0.76, 0.12, 1.0)
TABLE: Rgba = (0.43, 0.47, 0.52, 1.0)
TABLE_EDGE: Rgba = (0.30, 0.32, 0.35, 1.0)
FLOOR: Rgba = (0.80, 0.81, 0.83, 1.0)
SKY: Rgba = (0.72, 0.80, 0.90, 1.0)
HORIZON: Rgba = (0.93, 0.94, 0.96, 1.0)
