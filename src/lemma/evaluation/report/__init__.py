"""The contents of a report: tables and failed episodes."""
