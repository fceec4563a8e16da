"""The episode of a page, in its own thread, and commands to it."""
