"""Goals, instances, sampling and language of the suite."""
