"""Policies in other processes: the socket, and its protocol.

Whoever serves a policy needs NumPy, msgspec and websockets, and what the policy itself
needs: neither MuJoCo nor torch are imported here.
"""

from lemma.serve.server import PolicyServer, serve

__all__ = ["PolicyServer", "serve"]
