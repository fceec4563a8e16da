"""Episodes on disk: recipes, replays, and what is rendered from them."""
