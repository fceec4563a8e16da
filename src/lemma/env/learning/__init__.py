"""For learners: dense rewards, and flat views."""
