"""The messages, and the faults that they name."""
