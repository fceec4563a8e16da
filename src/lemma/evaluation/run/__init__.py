"""Execution of evaluations: policies, rollouts, lines of episodes."""
