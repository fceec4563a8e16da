"""Episodes as a LeRobotDataset, written by the lerobot package itself."""
