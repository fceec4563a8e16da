"""Renderings of recipes: keyframes and dense steps."""
