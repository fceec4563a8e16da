"""Asking a policy behind a socket or in another process."""
