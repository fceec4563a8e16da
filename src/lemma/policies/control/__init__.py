"""Policies at control level: their interface, and the expert behind it."""
