"""Adversaries: attempts to do with one robot what shall take two."""
