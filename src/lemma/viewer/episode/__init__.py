"""The episode of a page in a thread of its own, and commands to it."""
