"""Thousands of tables at once on a GPU, by MuJoCo Warp, for learners."""
