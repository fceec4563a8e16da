"""What is seen: bodies, light, names, and what can be laid over them."""
