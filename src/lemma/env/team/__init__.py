"""Orders to the free robots of a team, several of which work at the same time."""
