"""Episodes that somebody led by hand: kept in files, and done again."""
