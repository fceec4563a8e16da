"""Policies: planners, grounders, models of both levels, and their training."""
