"""Words that every layer shares: poses, randomness, registries, errors."""
