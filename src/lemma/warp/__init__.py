"""Thousands of parallel worlds on a GPU with MuJoCo Warp, for learning."""
