"""What is tested of a served policy before a run relies on it."""

from dataclasses import replace
from typing import Any

from lemma.core.errors import InvalidConfigError, RenderingError
from lemma.env.camera_rig import CameraRig
from lemma.evaluation.run.loading import FOREVER_S
from lemma.evaluation.run.server_probe import probe
from lemma.policies.spec import TIMEOUT_S, PolicySpec
from lemma.serve.client.conversation import ProtocolMode
from lemma.serve.client.websocket import connect, is_address
from lemma.serve.protocol.faults import PolicyUnreachableError
from lemma.serve.selftest.known_inputs import SelfTestReport, check


def check_server(url: str, timeout_s: float = TIMEOUT_S) -> SelfTestReport:
    """Return what the self-test finds at a server.

    First what the server understands of known inputs; then, if that is right, what its
    policy does in a few scenes.

    Args:
        url: Such as ``"http://127.0.0.1:8000"``.
        timeout_s: For one decision [s].

    Raises:
        InvalidConfigError: It is no address.
        PolicyUnreachableError: Nobody answers there.
        ProtocolError: Somebody answers who speaks something else.
    """
    part: Any = connect(url, ProtocolMode(timeout_s))
    try:
        report = check(part.conversation)
        if not report.ok or not hasattr(part, "act"):
            return report
        found = probe(part, CameraRig())
        return replace(report, acts=str(found), mistakes=found.mistakes)
    except RenderingError:
        return replace(
            report, acts="It was shown no scenes: OpenGL does not work here."
        )
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
        if not is_address(name):
            continue
        report = check_server(name, spec.timeout_s or FOREVER_S)
        if not report.ok:
            raise InvalidConfigError(f"{report} Or try with --skip-check.")
