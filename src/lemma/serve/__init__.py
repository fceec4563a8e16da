"""Policies in other processes: the socket, its protocol, and its self-test.

Whoever serves a policy needs NumPy, msgpack and websockets, and what the policy itself
needs: neither MuJoCo nor torch are imported here.
"""

from lemma.serve.server.server import PolicyServer, serve

__all__ = ["PolicyServer", "serve"]
