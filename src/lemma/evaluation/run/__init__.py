"""Running policies: protocol, rollouts, lines of episodes."""
