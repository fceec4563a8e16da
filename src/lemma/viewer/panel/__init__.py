"""What is chosen, pressed and read beside the scene."""
