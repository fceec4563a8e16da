"""Views of environments for learners: flat ones, and PettingZoo."""
