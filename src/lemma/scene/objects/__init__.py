"""Kinds of objects: shapes, and what can be done with them."""

# The kinds are registered in this order, by any order of imports: entities
# that users add are numbered by it.
from lemma.scene.objects import cube, pad, plank, stick

__all__ = ["cube", "pad", "plank", "stick"]
