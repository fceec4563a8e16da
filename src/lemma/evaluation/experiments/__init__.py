"""The rows of the tables, the figures of the paper, and how both are reproduced."""
