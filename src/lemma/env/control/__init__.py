"""Control modes, and the safety filter that keeps motors inside their limits."""
