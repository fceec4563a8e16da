"""Teams: where their robots stand, and who of them is needed."""
