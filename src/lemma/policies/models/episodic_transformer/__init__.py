"""The Episodic Transformer."""
