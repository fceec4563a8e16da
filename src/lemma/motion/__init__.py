"""RMPflow, and the motions that execute primitives."""
