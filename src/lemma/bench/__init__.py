"""Measuring speed, and checking an installation."""
