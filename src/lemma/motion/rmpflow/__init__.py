"""RMPflow: the workspace, its leaves, and the policy that resolves them."""
