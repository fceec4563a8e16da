"""The `lemma` command: one small file per verb."""
