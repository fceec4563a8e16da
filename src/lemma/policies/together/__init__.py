"""Policies for several robots at work at the same time."""
