"""Policies that see, read and act: planners, grounders, and what trains them."""
