"""Export of episodes as a LeRobotDataset with the lerobot package."""
