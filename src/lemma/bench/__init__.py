"""Measurement of speed, and checks of an installation."""
