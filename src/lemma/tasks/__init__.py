"""Tasks: goals, instances, sampling and language."""
