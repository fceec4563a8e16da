"""What is rendered from recipes: keyframes, dense steps."""
