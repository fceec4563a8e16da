"""Policies for several robots that act at the same time."""
