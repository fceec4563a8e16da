"""Export to LeRobotDataset."""
