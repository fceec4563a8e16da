"""Kinds of objects: shapes, and what can be done with them."""
