"""How well policies do: episodes played, counted and compared."""
