"""What lies on the table, how it is compiled, and who sees it."""
