"""Attacks by motor commands, one family in a file."""
