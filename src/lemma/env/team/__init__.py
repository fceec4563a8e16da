"""Orders to the free robots of a team that works in parallel."""
