"""Pages that are looked at in a browser: the live page, failures, and replays in 3-D.

Numbers and tables of results belong to ``evaluation.report``, pictures and static pages
to ``viz``.
"""
