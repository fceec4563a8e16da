"""Episodes played again, as files of the player and pages that need no server."""
