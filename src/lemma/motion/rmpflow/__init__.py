"""RMPflow: its workspace, its leaves, and the motion policy that combines them."""
