"""Control modes, and what keeps motors inside their limits."""
