"""ReachNet for teams of two to four robots."""
