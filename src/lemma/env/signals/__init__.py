"""Signals for learners: rewards, and a small state of what they are about."""
