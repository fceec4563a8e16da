"""Pictures, videos, plots and static pages, without a server or viser.

``evaluation.report`` computes the numbers and tables; ``viewer`` makes interactive 3D
scenes.
"""
