"""RMPflow, and the primitives as motions."""
