"""Scenes: objects, their compiled model, and cameras."""
