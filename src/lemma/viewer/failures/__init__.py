"""What went wrong: episodes of results, each at the moment that decided it."""
