"""What is played: an episode in a thread of its own, and commands to it."""
