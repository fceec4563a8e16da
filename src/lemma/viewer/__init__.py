"""Pages for a browser: the live page, failures, and replays in 3D.

``evaluation.report`` computes numbers and tables of results; ``viz`` makes pictures and
static pages.
"""
