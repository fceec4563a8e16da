"""Keyframes: images, maps and labels before each sub-task."""
