"""The experiments of the tables, the paper's figures, and their reproduction."""
