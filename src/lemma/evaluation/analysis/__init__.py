"""From lines of episodes to rates, causes and comparisons."""
