"""The `lemma` command: one module per verb."""
