"""Pictures, videos, plots and static pages; without a server, and without viser.

Numbers and tables come from ``evaluation.report``; scenes to turn around are made by
``viewer``.
"""
