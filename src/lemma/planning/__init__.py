"""Symbolic planning and geometric grounding with the true state."""
