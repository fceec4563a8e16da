"""The eight tasks, one file each."""
