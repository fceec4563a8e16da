"""The colors of objects, the stick's, and the room's."""

import re

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry

Rgba = tuple[float, float, float, float]

OBJECT_COLORS: Registry[Rgba] = Registry("object color")
"""Every color that an object may have, by name; the benchmark's own come first. Add
another with :func:`add_color`."""

_NAME = re.compile(r"[a-z]+")


def add_color(name: str, rgb: tuple[float, float, float]) -> Rgba:
    """Register a color of objects.

    Args:
        name: One lower-case English word, because instructions say it.
        rgb: Red, green and blue, each from 0 to 1.

    Returns:
        The color with an opacity of 1.

    Raises:
        InvalidConfigError: The name is taken or no such word, or a part is not in
            range.
    """
    if not _NAME.fullmatch(name):
        raise InvalidConfigError(
            f"An object color cannot be called {name!r}. Choose one word of lower-case "
            "letters."
        )
    if len(rgb) != 3 or not all(0.0 <= part <= 1.0 for part in rgb):
        raise InvalidConfigError(
            f"Color {name!r}: {rgb} is not red, green and blue from 0 to 1."
        )
    red, green, blue = (float(part) for part in rgb)
    return OBJECT_COLORS.add(name, (red, green, blue, 1.0))


add_color("pink", (0.95, 0.45, 0.68))
add_color("red", (0.80, 0.10, 0.10))
add_color("white", (0.95, 0.95, 0.93))
add_color("blue", (0.10, 0.28, 0.78))
add_color("green", (0.10, 0.55, 0.22))

BENCHMARK_COLORS = tuple(OBJECT_COLORS)
"""The colors that the benchmark draws from. Instances, numbers of entities and weights
count on these, so they do not grow with what is registered."""

STICK: Rgba = (0.96, 0.76, 0.12, 1.0)
TABLE: Rgba = (0.43, 0.47, 0.52, 1.0)
TABLE_EDGE: Rgba = (0.30, 0.32, 0.35, 1.0)
FLOOR: Rgba = (0.80, 0.81, 0.83, 1.0)
SKY: Rgba = (0.72, 0.80, 0.90, 1.0)
HORIZON: Rgba = (0.93, 0.94, 0.96, 1.0)
