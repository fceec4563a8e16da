"""The rows of the tables, the leaderboard, and the figures of the paper."""
