"""Audit: attacks in which one robot alone tries to do tasks that need several."""
