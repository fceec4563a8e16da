"""LEMMA Bench: language-conditioned multi-robot manipulation on MuJoCo."""

__version__ = "0.1.0"
