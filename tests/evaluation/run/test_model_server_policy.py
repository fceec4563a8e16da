"""Model servers of vla-eval play episodes of `lemma evaluate`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from expert_commands import HZ, expert_commands
from model_server import HELLO, model_server, wait_for

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.workers.pool import Serial
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.run.loading import MODEL_SERVER_DEFAULTS, ask_model_server
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.spec import PolicySpec
from lemma.serve.conversation import ProtocolMode

SOON = ProtocolMode(5.0, patience_s=0.0, first_patience_s=0.0)
BLIND = {"observation": "state", "control_hz": HZ}
"""The options that a server without need of pictures asks for."""
ENOUGH = 4


def asking(**params: Any) -> dict[str, Any]:
    return {**HELLO, "observation_params": params}


def moved(state: Any, step: int) -> Any:
    """Return a motion that ends with an error."""
    if step == ENOUGH:
        raise ValueError("That is enough.")
    return np.asarray(state, np.float64).reshape(2, 7) + 0.01 * step


class Here:
    """The same policy as an object of this process."""

    control_options: ClassVar[dict[str, Any]] = {**MODEL_SERVER_DEFAULTS, **BLIND}

    def act(self, inputs: list[ControlInput]) -> list[Actions]:
        return [
            Actions(moved(given.observation["agent_pos"], given.step))
            for given in inputs
        ]


def lines(policy: Any, level: str) -> list[dict[str, Any]]:
    found = lemma.evaluate(policy, level=level, tasks=["pass"], episodes=2)
    return [{**row, "wall_s": 0.0, "policy_error": None} for row in found.rows]


def test_a_server_plays_as_the_same_policy_does_here() -> None:
    def predict(seen: Mapping[str, Any], step: int) -> Any:
        assert seen["images"] == {}
        return {"actions": moved(seen["states"], step).ravel()}

    with model_server(predict, hello=asking(**BLIND)) as url:
        served = lines(url, "")
    here = lines(Here(), "control")
    for one, other in zip(served, here, strict=True):
        # The explanation of its exception has other words.
        one["lenient"], other["lenient"] = None, None
        assert one == other
        assert one["control"]["actions"] == ENOUGH


def test_the_experts_motion_succeeds_over_the_wire() -> None:
    commands = expert_commands("pass", "test", 0)

    def predict(seen: Mapping[str, Any], step: int) -> Any:
        return {"actions": commands[min(step, len(commands) - 1)]}

    log: list[dict[str, Any]] = []
    with model_server(predict, hello=asking(**BLIND), log=log) as url:
        found = lemma.evaluate(url, tasks=["pass"], episodes=1)
        wait_for(log, "episode_end", 1)
    assert found.success_rate == 1.0
    [row] = found.rows
    assert row["control"]["asked"] == row["control"]["actions"] > 100
    # Which instance it is would be the truth.
    [start] = [one["payload"] for one in log if one["type"] == "episode_start"]
    assert start == {"task": {"name": "lemma", "suite": "lemma"}}


@pytest.mark.render
def test_it_sees_what_is_asked_for(tmp_path: Path) -> None:
    seen: list[dict[str, Any]] = []

    def predict(given: dict[str, Any], step: int) -> Any:
        seen.append(given)
        if step:
            raise ValueError("That is enough.")
        return {"actions": np.zeros(14)}

    params = {"width": 40, "height": 30, "control": "delta_ee_pose"}
    with model_server(predict, hello=asking(**params, send_wrist_image=True)) as url:
        arguments = {"cameras": "overview+robot_1_wrist", "state": "agent_pos+tcp_pose"}
        config = EvaluationConfig(
            out=tmp_path,
            policy=PolicySpec(url, arguments=(*arguments.items(),)),
            tasks=("pass",),
            episodes=1,
        )
        told = config.about()["served"][url]
        [row] = evaluate(config, Serial())
    assert told["state"] == ["agent_pos", "tcp_pose"]
    assert told["control_options"]["width"] == 40
    assert told["model_server"] == "Stub"
    assert row["policy_error"]["kind"] == "raised"
    assert row["control"]["actions"] == 1
    shapes = {name: image.shape for name, image in seen[0]["images"].items()}
    assert shapes == dict.fromkeys(("overview", "robot_1_wrist"), (30, 40, 3))
    assert seen[0]["states"].shape == (28,)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"chunk": 8}, UnknownNameError, "option of a model server"),
        ({"control": "dance"}, UnknownNameError, "control mode"),
        ({"state": "agent_pos+mood"}, InvalidConfigError, "joined by"),
        ({"control": "ee_pose"}, InvalidConfigError, "takes 16 numbers"),
    ],
)
def test_what_is_asked_for_must_exist(
    arguments: dict[str, Any], error: type[Exception], words: str
) -> None:
    part = {"name": "actions", "format": "raw", "dims": 14}
    hello = {**HELLO, "action_spec": {"actions": part}}
    with (
        model_server(lambda seen, step: None, hello=hello) as url,
        pytest.raises(error, match=words),
    ):
        ask_model_server(url, SOON, arguments)
