"""Policies at control level: their interface, LeRobot's, and the expert."""
