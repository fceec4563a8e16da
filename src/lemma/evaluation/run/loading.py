"""Loading of policies by name, with external ones in separate processes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import (
    DatasetError,
    InvalidConfigError,
    UnknownNameError,
    WeightsError,
    shown,
)
from lemma.core.files import read_json, sha256_of
from lemma.env.control.modes import CONTROLS
from lemma.env.learning.flat_view import STATES
from lemma.policies.class_path import LEROBOT, checkpoint_of, privileged
from lemma.policies.control.interfaces import CONTROL_OPTIONS, is_model_server
from lemma.policies.interfaces import Composite, is_oracle
from lemma.policies.planners.registry import PLANNERS, is_planner
from lemma.policies.spec import (
    DEVICES,
    FOREVER_S,
    ORACLE,
    PolicySpec,
    load_part,
    parts_of,
)
from lemma.policies.weights import find_weights, published_weights
from lemma.scene.cameras import CLOSE_PX
from lemma.serve.conversation import ProtocolMode, Remote
from lemma.serve.isolation import isolate
from lemma.serve.model_server import ModelServer
from lemma.serve.websocket import connect, is_address


def load_policy(spec: PolicySpec) -> Any:
    """Return a policy, with external classes in separate processes.

    Clients of servers use sockets. With a time limit, external classes run in separate
    processes. Without one they run in this process, so that a debugger can be used, and
    they may be oracles. Policies of this package run in this process, too.

    Args:
        spec: The policy's name and options.

    Raises:
        LemmaError: There is no such policy, its server does not answer, or its weights
            are damaged; or it needs privileged state, and its class is no oracle.
    """

    def load(name: str) -> Any:
        if is_address(name) or is_model_server(name):
            return connected(spec, name)
        # Other processes get no privileged state.
        if ":" in name and spec.timeout_s > 0.0 and not privileged(name):
            return isolate(name, spec.timeout_s, dict(spec.arguments))
        return load_part(name, dict(spec.arguments), spec.device)

    if spec.device != DEVICES[0]:
        _use_float32()
    found = spec.load(load)
    if is_oracle(found) and not spec.oracle:
        raise InvalidConfigError(
            f"{spec.name} needs privileged state, but is not marked as an oracle. Name "
            "a class that is derived from lemma.policies.interfaces.Oracle."
        )
    return found


def _use_float32() -> None:
    """Use float32 on a GPU, too; by default its convolutions round to 11 bits."""
    import torch  # noqa: PLC0415 - only models on a GPU need it

    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cudnn.deterministic = True


def check_device(spec: PolicySpec) -> None:
    """Check that a policy has a model to put on its device, and that there is one.

    Raises:
        InvalidConfigError: It has no model of this package, or there is no GPU.
    """
    if spec.device == DEVICES[0]:
        return
    if not learned_parts(spec.name):
        raise InvalidConfigError(
            f"{spec.name} has no model of this package, so a device does not apply. "
            "Leave out --device; a policy of your own chooses its device itself."
        )
    from lemma.policies.batch import check_gpu  # noqa: PLC0415 - it needs torch

    check_gpu()


def hang_up(policy: Any) -> None:
    """End the processes and the connections of a loaded policy."""
    if isinstance(policy, Composite):
        for part in policy.parts:
            hang_up(part)
    elif isinstance(policy, Remote | ModelServer):
        policy.close()


def served_parts(spec: PolicySpec) -> dict[str, Any]:
    """Return the self-descriptions of the servers among a policy's parts, by address.

    Raises:
        LemmaError: A server does not answer, or has another protocol.
    """
    found = {}
    for name in spec.parts:
        if is_address(name) or is_model_server(name):
            part = connected(spec, name)
            found[name] = part.about
            part.close()
    return found


def connected(spec: PolicySpec, address: str) -> Any:
    """Return a client of a policy server.

    Args:
        spec: Options with the time limit, and the environment of a model server.
        address: Address of ``lemma serve`` or of a model server.

    Raises:
        LemmaError: The server does not answer, or has another protocol.
    """
    mode = ProtocolMode(spec.timeout_s or FOREVER_S)
    if is_model_server(address):
        return ask_model_server(address, mode, dict(spec.arguments))
    return connect(address, mode)


MODEL_SERVER_DEFAULTS: dict[str, Any] = {
    "control": "joint_position",
    "control_hz": 20.0,
    "observation": "rgb",
    "clip_actions": True,
    "width": CLOSE_PX,
    "height": CLOSE_PX,
}
"""Default options, as in the benchmark for vla-eval's own harness."""
_STATE = "state"


def ask_model_server(
    url: str, mode: ProtocolMode, asked: Mapping[str, Any]
) -> ModelServer:
    """Return a model server as a policy.

    Its action space is the requested one; otherwise that in the server's
    ``observation_params``; otherwise the default.

    Args:
        url: Such as ``"vla-eval://127.0.0.1:8001"``.
        mode: Time limits of the protocol.
        asked: Options, of :data:`lemma.policies.control.interfaces.CONTROL_OPTIONS`,
            and ``state``, the parts of the state.

    Raises:
        LemmaError: There is no such option, the server does not answer, or it has
            another action space.
    """
    valid = (*CONTROL_OPTIONS, _STATE)
    for name in asked:
        known("option of a model server", name, valid)
    server = ModelServer(url, mode)
    params = server.welcome.get("observation_params")
    wanted = params if isinstance(params, Mapping) else {}
    options = {
        **MODEL_SERVER_DEFAULTS,
        **{name: value for name, value in wanted.items() if name in valid},
        **asked,
    }
    state = _names(options.pop(_STATE, STATES[:1]))
    if "cameras" in options:
        options["cameras"] = _names(options["cameras"])
    if not state or not set(state) <= set(STATES):
        raise InvalidConfigError(
            f"state={shown(state)} is invalid. Valid: some of {', '.join(STATES)}, "
            "joined by +."
        )
    server.use(options, CONTROLS[options["control"]].columns, state)
    return server


def _names(names: Any) -> tuple[str, ...]:
    """Return several names; on the command line they are joined by ``+``."""
    return tuple(names.split("+") if isinstance(names, str) else names)


Weights = dict[str, dict[str, Any]]
"""By name of the model: hash, training seed, digest of the data; and whether a time
limit ended the training."""


def learned_parts(policy: str) -> list[str]:
    """Return the parts of a policy's name that are names or files of weights."""
    # Addresses and names of classes contain a colon.
    return [
        part
        for part in parts_of(policy)
        if part != ORACLE and ":" not in part and not is_planner(part)
    ]


def weights_of(spec: PolicySpec) -> Weights:
    """Return the weights of a policy; none for oracles and external policies.

    Raises:
        LemmaError: Weights are missing or damaged.
    """
    checkpoint = checkpoint_of(spec.name)
    if checkpoint is not None:
        return _lerobot_weights(checkpoint)
    parts = dict.fromkeys(learned_parts(spec.name))
    for planner in spec.planners():
        parts |= dict.fromkeys(getattr(planner, "weights", ()))
    return dict(_weights_in(_find(part)) for part in parts)


def _weights_in(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the model's name in a file of weights, and an entry of :data:`Weights`.

    Raises:
        WeightsError: The file is damaged.
    """
    # torch is an optional dependency, which oracles and external policies do not need.
    from lemma.policies.weights_file import TIME_LIMIT, read_metadata  # noqa: PLC0415

    about = read_metadata(path)
    ended = {"ended": about.ended} if about.ended == TIME_LIMIT else {}
    digest, data = sha256_of(path), dict(about.data)
    for one in published_weights().values():
        # The list has a digest of the data that older files lack.
        if one["sha256"] == digest and "of_any_renderer" in one:
            data["of_any_renderer"] = one["of_any_renderer"]
    return about.model.removeprefix(LEROBOT), {
        "sha256": digest,
        "seed": about.training.get("seed", 0),
        "data": data,
        **ended,
    }


def _lerobot_weights(name: str) -> Weights:
    """Return the weights of a LeRobot folder, or published ones.

    For a name on the Hub there are none. A folder of ``save_pretrained`` does not have
    the data and the seed of the training, so the entry lacks them.

    Raises:
        WeightsError: The folder is damaged.
    """
    if name in published_weights():
        return dict([_weights_in(find_weights(name))])
    folder = Path(name)
    weights = folder / "model.safetensors"
    if not weights.exists():
        return {}
    found: dict[str, Any] = {"sha256": sha256_of(weights)}
    try:
        kind = str(read_json(folder / "config.json")["type"])
        if (folder / "train_config.json").exists():
            training = read_json(folder / "train_config.json")
            found["seed"] = training["seed"] or 0
            found["data"] = {"repo_id": training["dataset"]["repo_id"]}
            if "ended" in training:  # by scripts/train_lerobot_policy.py
                found["ended"] = training["ended"]
    except (DatasetError, KeyError, TypeError) as error:
        raise WeightsError(
            f"{name} is no whole checkpoint of LeRobot: its config.json or "
            f"train_config.json cannot be read ({error}). Save it again with "
            "save_pretrained, or name the folder that lerobot-train wrote."
        ) from error
    return {kind: found}


def _find(part: str) -> Path:
    try:
        return find_weights(part)
    except UnknownNameError:
        checkpoints = (
            f"{LEROBOT}{name}" if entry["model"].startswith(LEROBOT) else name
            for name, entry in published_weights().items()
        )
        valid = (ORACLE, *PLANNERS, *checkpoints)
        raise UnknownNameError("policy", part, valid) from None
