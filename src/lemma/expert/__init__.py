"""The oracle: it plans, grounds and acts, and makes mistakes on purpose."""
