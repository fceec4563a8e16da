"""Instructions: templates and template banks."""
