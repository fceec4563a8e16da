"""What learners ask for: rewards on the way, and flat views."""
