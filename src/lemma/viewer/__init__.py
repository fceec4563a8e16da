"""A page in the browser: a table, two robots, and a sentence that they follow."""
