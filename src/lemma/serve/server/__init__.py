"""Answering for a policy."""
