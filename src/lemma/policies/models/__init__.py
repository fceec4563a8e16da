"""The learned models, one folder each."""
