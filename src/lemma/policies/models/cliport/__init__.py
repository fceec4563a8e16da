"""CLIPort, a grounder, and M-CLIPort, a policy without a planner."""
