"""What fixes a number: the protocol, its controls and the expert's times."""
