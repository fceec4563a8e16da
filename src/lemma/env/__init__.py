"""Scenes in motion: the step loop, episodes, Gymnasium and PettingZoo."""
