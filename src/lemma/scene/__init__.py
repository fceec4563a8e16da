"""Scenes: objects, the compiled MuJoCo model, and cameras."""
