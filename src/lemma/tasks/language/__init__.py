"""Instructions: templates, and banks of them."""
