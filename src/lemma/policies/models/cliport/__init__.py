"""CLIPort, and M-CLIPort without a planner."""
