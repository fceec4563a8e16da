"""Policies by name, with other people's kept at a distance."""

from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.policies.interfaces import Policy
from lemma.policies.specification import TIMEOUT_S, PolicySpec, load_part
from lemma.serve.conversation import Manners
from lemma.serve.faults import PolicyUnreachableError
from lemma.serve.golden import Report, check
from lemma.serve.isolation import isolate
from lemma.serve.websocket import connect, is_address


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
            return connect(name, Manners(spec.timeout_s))
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
            part = connect(name, Manners(spec.timeout_s))
            found[name] = part.about
            part.close()
    return found


def check_server(url: str) -> Report:
    """Return what the self-test finds at a server.

    Args:
        url: Such as ``"http://127.0.0.1:8000"``.

    Raises:
        InvalidConfigError: It is no address.
        PolicyUnreachableError: Nobody answers there.
        ProtocolError: Somebody answers who speaks something else.
    """
    part = connect(url, Manners(TIMEOUT_S))
    try:
        return check(part.conversation)
    except OSError as error:
        raise PolicyUnreachableError(
            f"{url} did not answer the self-test: {error or type(error).__name__}."
        ) from error
    finally:
        part.close()


def check_served(spec: PolicySpec) -> None:
    """Test the servers among a policy's parts before they are relied on.

    Raises:
        InvalidConfigError: One of them misunderstands what it is sent.
        LemmaError: One of them does not answer.
    """
    for name in spec.parts:
        if is_address(name) and not (report := check_server(name)).ok:
            raise InvalidConfigError(f"{report} Or try with --skip-check.")
