"""Symbolic planning and geometric grounding, from the true state."""
