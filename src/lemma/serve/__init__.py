"""Policies in other processes: sockets and protocols.

Serving a policy needs only NumPy, msgspec and websockets besides the policy's own
packages; this package imports neither MuJoCo nor torch.
"""

from lemma.serve.server import PolicyServer, serve

__all__ = ["PolicyServer", "serve"]
