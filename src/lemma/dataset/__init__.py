"""Episodes on disk: recipes, replays and renderings."""
