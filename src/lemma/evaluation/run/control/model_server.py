"""Which environment a model server of vla-eval acts in."""

from collections.abc import Mapping
from typing import Any

from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.env.control.modes import CONTROLS
from lemma.env.learning.flat_view import STATES
from lemma.policies.control.interfaces import CONTROL_OPTIONS
from lemma.serve.conversation import ProtocolMode
from lemma.serve.model_server import ModelServer

DEFAULTS: dict[str, Any] = {
    "control": "joint_position",
    "control_hz": 20.0,
    "observation": "rgb",
    "clip_actions": True,
    "width": 224,
    "height": 224,
}
"""As in the benchmark for vla-eval's own harness."""
STATE = "state"


def ask_model_server(
    url: str, mode: ProtocolMode, asked: Mapping[str, Any]
) -> ModelServer:
    """Return a model server as a policy.

    Its action space is the requested one, else the one that the server names in its
    ``observation_params``, else the default.

    Args:
        url: Such as ``"vla-eval://127.0.0.1:8001"``.
        mode: How patient to be.
        asked: Options, of :data:`lemma.policies.control.interfaces.CONTROL_OPTIONS`,
            and ``state``: what the state consists of.

    Raises:
        LemmaError: There is no such option, nobody answers there, or its actions are
            others.
    """
    valid = (*CONTROL_OPTIONS, STATE)
    for name in asked:
        if name not in valid:
            raise UnknownNameError("option of a model server", name, valid)
    server = ModelServer(url, mode)
    params = server.welcome.get("observation_params")
    wanted = params if isinstance(params, Mapping) else {}
    options = {
        **DEFAULTS,
        **{name: value for name, value in wanted.items() if name in valid},
        **asked,
    }
    state = _names(options.pop(STATE, STATES[:1]))
    if "cameras" in options:
        options["cameras"] = _names(options["cameras"])
    if not state or not set(state) <= set(STATES):
        raise InvalidConfigError(
            f"state={shown(state)} is impossible. Valid: some of {', '.join(STATES)}, "
            "joined by +."
        )
    server.use(options, CONTROLS[options["control"]].columns, state)
    return server


def _names(told: Any) -> tuple[str, ...]:
    """Return several names, also of a command line, where ``+`` is between them."""
    return tuple(told.split("+") if isinstance(told, str) else told)
