"""The colors of objects, of the stick and of the room."""

import re

from lemma.core.errors import InvalidConfigError
from lemma.core.registry import Registry

Rgba = tuple[float, float, float, float]

_NAME = re.compile(r"[a-z]+")


def _check(name: str, rgba: Rgba) -> None:
    """Check a color of objects.

    Raises:
        InvalidConfigError: The name is not a single lower-case word, as instructions
            need, or the color is not four numbers from 0 to 1, or not opaque.
    """
    if not _NAME.fullmatch(name):
        raise InvalidConfigError(
            f"An object color cannot be called {name!r}. Choose one word of lower-case "
            "letters."
        )
    if len(rgba) != 4 or not all(0.0 <= part <= 1.0 for part in rgba) or rgba[3] < 1.0:
        raise InvalidConfigError(
            f"Color {name!r} cannot be {rgba}. Give red, green and blue from 0 to 1, "
            "and an opacity of 1."
        )


OBJECT_COLORS: Registry[Rgba] = Registry("object color", Rgba, on_add=_check)
"""All colors of objects, by name; the benchmark's own come first."""

OBJECT_COLORS.add("pink", (0.95, 0.45, 0.68, 1.0))
OBJECT_COLORS.add("red", (0.80, 0.10, 0.10, 1.0))
OBJECT_COLORS.add("white", (0.95, 0.95, 0.93, 1.0))
OBJECT_COLORS.add("blue", (0.10, 0.28, 0.78, 1.0))
OBJECT_COLORS.add("green", (0.10, 0.55, 0.22, 1.0))

BENCHMARK_COLORS = tuple(OBJECT_COLORS)
"""The benchmark's colors. Instances, numbers of entities and weights depend on them, so
registered colors are not added."""

STICK: Rgba = (0.96, 0.76, 0.12, 1.0)
TABLE: Rgba = (0.43, 0.47, 0.52, 1.0)
TABLE_EDGE: Rgba = (0.30, 0.32, 0.35, 1.0)
FLOOR: Rgba = (0.80, 0.81, 0.83, 1.0)
SKY: Rgba = (0.72, 0.80, 0.90, 1.0)
HORIZON: Rgba = (0.93, 0.94, 0.96, 1.0)
