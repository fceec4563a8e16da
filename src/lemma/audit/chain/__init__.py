"""Attacks that push one thing with another, at control level: rows and relays."""
