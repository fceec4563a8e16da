"""Signals for learners: rewards, progress, and a small goal state."""
