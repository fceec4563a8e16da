"""Known inputs, by which a server shows that it understands them."""
