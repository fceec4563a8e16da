"""The protocol, which fixes a number: rules, controls and the expert's times."""
