"""Attacks by grounded sub-tasks, one family in a file."""
