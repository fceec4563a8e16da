"""Policies in other processes: the socket, and its protocol.

Serving a policy needs NumPy, msgspec and websockets, and the policy's own packages:
neither MuJoCo nor torch is imported here.
"""

from lemma.serve.server import PolicyServer, serve

__all__ = ["PolicyServer", "serve"]
