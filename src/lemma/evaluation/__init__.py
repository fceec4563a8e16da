"""Evaluation of policies: episodes, counts and comparisons."""
