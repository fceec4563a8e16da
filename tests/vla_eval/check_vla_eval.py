"""The real vla-eval plays LEMMA, and its model servers are asked by LEMMA.

Run by `make test-vla-eval`, in an environment of its own.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from expert_commands import expert_commands
from vla_eval.api import run, serve_background
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.specs import IMAGE_RGB, LANGUAGE, RAW

import lemma
from lemma.core.robot_names import robot_names
from lemma.env.camera_rig import close_cameras
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.serve.conversation import ProtocolMode
from lemma.serve.faults import PolicyFailedError
from lemma.serve.model_server import ModelServer
from lemma.serve.server import PolicyServer
from lemma.tasks.suite import load_instance

CONFIG = Path(__file__).parents[2] / "integrations/vla_eval/eval.yaml"
TASKS = ["pass", "stack", "poke", "hook"]
SIZE = {"width": 64, "height": 48}


class Own(PredictModelServer):
    """Declares what servers of LeRobot policies declare."""

    def get_action_spec(self) -> dict[str, Any]:
        return {"actions": RAW}

    def get_observation_spec(self) -> dict[str, Any]:
        return {"image": IMAGE_RGB, "language": LANGUAGE, "state": RAW}

    def get_observation_params(self) -> dict[str, Any]:
        return {"send_state": True}


class Hold(Own):
    """Stays where it is."""

    def predict(self, obs: Any, ctx: Any) -> Any:
        return {"actions": obs["states"]}


class Recorded(Own):
    """Repeats the expert's motion, in chunks, and keeps what it saw first."""

    def __init__(self) -> None:
        super().__init__(chunk_size=10)
        self.seen: dict[tuple[str, int], Any] = {}

    async def on_episode_start(self, config: Any, ctx: Any) -> None:
        task = config["task"]
        self.key = (task["name"], task["episode_idx"])
        self.commands = expert_commands(task["name"], task["split"], self.key[1])
        self.done = 0
        await super().on_episode_start(config, ctx)

    def predict(self, obs: Any, ctx: Any) -> Any:
        self.seen.setdefault(self.key, obs)
        numbers = np.arange(self.done, self.done + 10)
        self.done += 10
        return {"actions": self.commands[numbers.clip(max=len(self.commands) - 1)]}


def test_vla_eval_run_plays_and_the_experts_motion_succeeds(tmp_path: Path) -> None:
    server = Recorded()
    with serve_background(server) as handle:
        command = [
            *(str(Path(sys.executable).parent / "vla-eval"), "run", "--no-docker"),
            *("--config", str(CONFIG), "--server-url", handle.url),
            *("--output-dir", str(tmp_path), "--benchmark-field=episodes_per_task=2"),
            *(f"--param={name}={value}" for name, value in SIZE.items()),
            f"--param=tasks=[{','.join(TASKS)}]",
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Spec validation passed" in done.stderr
    for word in ("WARNING", "ERROR", "Traceback"):
        assert word not in done.stderr, done.stderr
    found = json.loads((tmp_path / "lemma_aggregate.json").read_text())
    assert found["mean_success"] == 1.0
    assert found["mean_progress"] == 1.0
    assert found["mean_elapsed_s"] > 5.0
    assert set(server.seen) == {(task, index) for task in TASKS for index in (0, 1)}
    for (task, index), seen in server.seen.items():
        instance = load_instance(task, "test", index)
        assert seen["task_description"] == instance.instructions["high_level"]
        assert set(seen["images"]) == set(close_cameras(robot_names(2)))
        for image in seen["images"].values():
            assert (image.shape, image.dtype) == ((48, 64, 3), np.uint8)
            assert image.std() > 5.0
        assert seen["states"].shape == (14,)


def few_steps(server: Any, **params: Any) -> list[dict[str, Any]]:
    """Return episodes of a few steps."""
    overrides = {
        "episodes_per_task": 2,
        "max_steps": 3,
        "params": {**SIZE, "tasks": ["stack"], **params},
    }
    config = str(CONFIG)
    with serve_background(server) as handle:
        [result] = run(
            config,
            server_url=handle.url,
            no_save=True,
            docker=False,
            benchmark_overrides=overrides,
        )
    return [episode for task in result["tasks"] for episode in task["episodes"]]


class Wrong(Own):
    """Answers one wrong thing in the first episode, and holds in others."""

    def __init__(self, answer: Any) -> None:
        super().__init__()
        self.answer, self.index = answer, 0

    async def on_episode_start(self, config: Any, ctx: Any) -> None:
        self.index = config["task"]["episode_idx"]
        await super().on_episode_start(config, ctx)

    def predict(self, obs: Any, ctx: Any) -> Any:
        return {"actions": obs["states"]} if self.index else self.answer


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"actions": np.full(14, np.nan)}, "robot_0.shoulder_pan is nan"),
        ({"actions": np.zeros(7)}, "shape (7,). Valid: 'actions' of shape (14,)"),
        ({"actions": np.zeros((5, 14))}, "chunk_size=5"),
        ({"moves": 1}, "no 'actions'"),
    ],
)
def test_what_is_wrong_is_said_and_the_run_goes_on(answer: Any, words: str) -> None:
    first, second = few_steps(Wrong(answer))
    assert first["failure_reason"] == "env_step"
    assert words in first["failure_detail"]
    assert "failure_reason" not in second
    # It was cut, so it has failed.
    assert second["metrics"]["success"] is False
    assert second["steps"] == 3


@pytest.mark.parametrize(
    ("control", "numbers"), [("delta_ee_pose", 14), ("ee_pose_rot6d", 20)]
)
def test_other_control_modes_and_cameras(control: str, numbers: int) -> None:
    class Still(Own):
        def predict(self, obs: Any, ctx: Any) -> Any:
            assert set(obs["images"]) == {"overview", "robot_1_wrist"}
            assert obs["states"].shape == (28,)
            down = [0.0, 0.5, 0.5, 1, 0, 0, 0, -1, 0, 0.1]
            row = [0.0] * 7 if control == "delta_ee_pose" else down
            return {"actions": np.array([*row, *row])}

    episodes = few_steps(
        Still(),
        control=control,
        cameras=["overview", "robot_1_wrist"],
        state=["agent_pos", "tcp_pose"],
    )
    assert [episode["steps"] for episode in episodes] == [3, 3]
    assert all("failure_reason" not in episode for episode in episodes)


class Asks(Own):
    """Repeats the expert's motion in one instance, and asks for an environment."""

    def __init__(self, commands: Any) -> None:
        super().__init__(chunk_size=len(commands))
        self.commands = commands

    def get_observation_params(self) -> dict[str, Any]:
        return {**SIZE, "send_state": True, "cameras": ["overview"]}

    def predict(self, obs: Any, ctx: Any) -> Any:
        assert {name: one.shape for name, one in obs["images"].items()} == {
            "overview": (48, 64, 3)
        }
        return {"actions": self.commands}


def test_its_servers_play_episodes_of_lemma_evaluate() -> None:
    server = Asks(expert_commands("pass", "test", 0))
    with serve_background(server) as handle:
        url = handle.url.replace("ws://", "vla-eval://")
        found = lemma.evaluate(url, tasks=["pass"], episodes=2)
    # The expert's commands for the first episode do not solve the second.
    assert [row["success"] for row in found.rows] == [True, False]
    assert found.errors == ()
    assert found.rows[0]["control"]["asked"] == found.rows[0]["control"]["actions"]


class Here:
    """The expert's motion again, as a policy of LEMMA."""

    control_options: ClassVar[dict[str, Any]] = {**SIZE, "cameras": ["robot_1"]}

    def act(self, inputs: list[ControlInput]) -> list[Any]:
        [given] = inputs
        assert given.observation["pixels"]["robot_1"].shape == (48, 64, 3)
        assert [name.split()[-1] for name in given.robots] == ["robot", "robot"]
        return [expert_commands("pass", "test", 0).reshape(-1, 2, 7)]


def test_our_policies_are_played_by_its_harness() -> None:
    with PolicyServer(Here(), port=0, protocol="vla-eval") as server:
        [result] = run(
            str(CONFIG),
            server_url=server.url.replace("http", "ws"),
            no_save=True,
            docker=False,
            benchmark_overrides={"episodes_per_task": 1, "params": {"tasks": ["pass"]}},
        )
    assert result["mean_success"] == 1.0


def test_its_servers_are_asked_by_our_client() -> None:
    class Fails(Hold):
        def predict(self, obs: Any, ctx: Any) -> Any:
            if obs["task_description"] == "fail":
                raise ValueError("as it was told")
            return super().predict(obs, ctx)

    state = np.linspace(0.0, 1.0, 14)
    image = np.zeros((48, 64, 3), np.uint8)
    with serve_background(Fails()) as handle:
        url = handle.url.replace("ws://", "vla-eval://")
        client = ModelServer(url, ProtocolMode(10.0))
        client.use({"control": "joint_position"}, [f"number {n}" for n in range(7)])
        assert client.about["model_server"] == "Fails"
        seen = [
            ControlInput(
                instruction=word,
                robots=("red robot", "blue robot"),
                observation={"agent_pos": state, "pixels": {"robot_0": image}},
            )
            for word in ("go", "fail", "go", "go")
        ]
        found = client.act(seen)
        assert isinstance(found[0], Actions)
        assert np.allclose(np.ravel(found[0].rows), state, atol=1e-6)
        assert isinstance(found[1], PolicyFailedError)
        assert "as it was told" in str(found[1])
        del found
        client.close()
