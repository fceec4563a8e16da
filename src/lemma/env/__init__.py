"""Scenes in motion: the step loop, episodes, and their Gymnasium and PettingZoo faces."""
