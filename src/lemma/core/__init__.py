"""Common base of all layers: poses, random streams, registries, errors."""
