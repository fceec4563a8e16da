"""The oracle: symbolic planning and geometric grounding."""
