"""Names of everything that can be picked up or put something on, in a fixed order."""

from lemma.scene.palette import OBJECT_COLOURS

STICK = "stick"
"""Name of the one L-shaped stick."""
SHARED = "shared"
"""Place entity: the region that every robot of the team reaches."""
ENTITIES = (
    *(f"{colour}_cube" for colour in OBJECT_COLOURS),
    *(f"{colour}_pad" for colour in OBJECT_COLOURS),
    STICK,
)
"""Every object that may be on a table, in the order of their numbers."""
