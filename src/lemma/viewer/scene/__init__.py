"""The scene of a page: bodies, light, names and overlays."""
