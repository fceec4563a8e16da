"""The oracle: symbolic planning, exact allocation, geometric grounding."""
