"""Policies by name, with other people's kept at a distance."""

from typing import Any

from lemma.policies.interfaces import Policy
from lemma.policies.specification import PolicySpec, load_part
from lemma.serve.conversation import Manners
from lemma.serve.isolation import isolate
from lemma.serve.websocket import connect, is_address

FOREVER_S = 1e6
"""What stands for any time [s]."""


def load_policy(spec: PolicySpec) -> Policy:
    """Return a policy that may be asked without fear.

    Servers are asked over their sockets. Classes of other people live in processes of
    their own, unless no timeout is wanted: then they live here, where a debugger finds
    them and they see the truth. Everything else is ours.

    Args:
        spec: Which policy.

    Raises:
        LemmaError: There is no such policy, nobody answers where it should be, or its
            weights are damaged.
    """

    def load(name: str) -> Any:
        if is_address(name):
            return connect(name, Manners(spec.timeout_s or FOREVER_S))
        if ":" in name and spec.timeout_s > 0.0:
            return isolate(name, spec.timeout_s)
        return load_part(name)

    return spec.load(load)


def served_parts(spec: PolicySpec) -> dict[str, Any]:
    """Return what the servers among a policy's parts say of themselves, by address.

    Raises:
        LemmaError: Nobody answers there, or in another language.
    """
    found = {}
    for name in spec.parts:
        if is_address(name):
            part = connect(name, Manners(spec.timeout_s or FOREVER_S))
            found[name] = part.about
            part.close()
    return found
