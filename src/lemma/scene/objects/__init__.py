"""Kinds of objects: shapes, and what can be done with them."""

# Whichever module is imported first, the kinds are registered in this order: entities
# that users add are numbered by it.
from lemma.scene.objects import cube, pad, stick

__all__ = ["cube", "pad", "stick"]
