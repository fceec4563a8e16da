"""Interfaces of environments for learners: flat arrays, and PettingZoo."""
