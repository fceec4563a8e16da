"""Kinds of objects: shapes and affordances."""

# Import in this order, so that the kinds are always registered in the same order, which
# defines the numbers of entities.
from lemma.scene.objects import cube, pad, plank, rod, stick, tray

__all__ = ["cube", "pad", "plank", "rod", "stick", "tray"]
