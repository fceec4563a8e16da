"""Policies of this package behind vla-eval's protocol."""

import re
import urllib.request
from typing import Any, ClassVar

import numpy as np
import pytest
from expert_commands import expert_commands
from model_server import pack, unpack

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.serve.conversation import ProtocolMode
from lemma.serve.faults import PolicyUnreachableError
from lemma.serve.model_server import ModelServer
from lemma.serve.server import PolicyServer
from lemma.serve.session import ModelSession


class Counts:
    """Repeats a motion in chunks of three, by what it remembers."""

    control_options: ClassVar[dict[str, Any]] = {"observation": "state"}

    def __init__(self, rows: Any) -> None:
        self.rows = np.asarray(rows, np.float64).reshape(-1, 2, 7)
        self.seen: list[ControlInput] = []

    def act(self, inputs: list[ControlInput]) -> list[Actions]:
        self.seen += inputs
        return [self._act(given.memory or 0) for given in inputs]

    def _act(self, done: int) -> Actions:
        numbers = np.arange(done, done + 3).clip(max=len(self.rows) - 1)
        return Actions(self.rows[numbers], done + 3)


@pytest.mark.slow
def test_a_served_policy_is_the_same_policy() -> None:
    rows = expert_commands("pass", "test", 0)
    here, there = Counts(rows), Counts(rows)
    own = lemma.evaluate(here, level="control", tasks=["pass"], episodes=1)
    with PolicyServer(there, port=0, protocol="vla-eval") as server:
        with urllib.request.urlopen(f"{server.url}/health") as health:
            assert health.status == 200
        url = server.url.replace("http", "vla-eval")
        served = lemma.evaluate(url, tasks=["pass"], episodes=1)
    assert own.success_rate == served.success_rate == 1.0
    [one], [other] = own.rows, served.rows
    assert other["control"].pop("asked") == other["control"]["actions"]
    assert one["control"].pop("asked") == len(here.seen) == len(there.seen)
    assert {**one, "wall_s": 0} == {**other, "wall_s": 0}
    for given, told in zip(here.seen, there.seen, strict=True):
        for name in ("agent_pos", "agent_vel", "tcp_pose"):
            np.testing.assert_array_equal(
                given.observation[name], told.observation[name]
            )
        assert (given.instruction, given.robots) == (told.instruction, told.robots)
        assert (given.step, given.memory) == (told.step, told.memory)
        assert told.time_s == pytest.approx(given.time_s)


@pytest.fixture
def session() -> ModelSession:
    return ModelSession(Counts(np.arange(42.0)))


def said(session: ModelSession, kind: str, payload: Any, seq: int = 7) -> Any:
    found = session.answer(pack(kind, payload, seq))
    return unpack(found) if found else None


def test_it_says_what_it_needs(session: ModelSession) -> None:
    welcome = said(session, "hello", {"protocol_version": 1})
    assert (welcome["type"], welcome["seq"]) == ("hello", 7)
    told = welcome["payload"]
    assert told["protocol_version"] == 1
    assert told["model_server"] == "Counts"
    assert told["observation_params"]["control"] == "joint_position"
    assert told["observation_params"]["state"] == ["agent_pos", "agent_vel", "tcp_pose"]
    assert told["action_spec"]["actions"]["format"] == "lemma_joint_position"


def test_chunks_are_given_out_and_episodes_begin_anew(session: ModelSession) -> None:
    seen = {"task_description": "go", "states": np.zeros(42, np.float32)}
    for _ in range(2):
        assert said(session, "episode_start", {"task": {}}) is None
        for step in range(3):
            answer = said(session, "observation", seen, step)
            assert (answer["type"], answer["seq"]) == ("action", step)
            assert answer["payload"]["actions"].tolist() == [
                *range(14 * step, 14 * step + 14)
            ]
        assert said(session, "episode_end", {}) is None


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        ({"task_description": "go"}, "state of 0 numbers"),
        ({"states": np.zeros(14)}, r"state: \[agent_pos, agent_vel, tcp_pose\]"),
    ],
)
def test_what_is_missing_is_said(
    session: ModelSession, seen: dict[str, Any], words: str
) -> None:
    answer = said(session, "observation", seen)
    assert (answer["type"], answer["seq"]) == ("error", 7)
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(answer["payload"]["error"])


def test_trouble_of_the_machine_ends_the_run_of_the_other_side() -> None:
    class Starves(Counts):
        def act(self, inputs: list[ControlInput]) -> list[Actions]:
            raise MemoryError

    with PolicyServer(Starves(np.zeros(14)), port=0, protocol="vla-eval") as server:
        url = server.url.replace("http", "vla-eval")
        there = ModelServer(url, ProtocolMode(5.0))
        there.use({"control": "joint_position"}, [f"{n}" for n in range(7)])
        robots, state = ("red robot", "blue robot"), {"agent_pos": np.zeros(42)}
        seen = ControlInput(instruction="go", robots=robots, observation=state)
        with pytest.raises(PolicyUnreachableError, match="MemoryError"):
            there.act([seen])
        there.close()


@pytest.mark.parametrize("rows", ["left", 3.0, np.zeros((0, 2, 7))])
def test_what_is_no_action_is_said(session: ModelSession, rows: Any) -> None:
    session._policy.act = lambda inputs: [rows]
    answer = said(session, "observation", {"states": np.zeros(42)})
    assert answer["type"] == "error"
    assert re.match("The policy answered|The actions are", answer["payload"]["error"])


def test_hostile_frames_are_answered(session: ModelSession) -> None:
    for frame in ("text", b"\xc1", b"\x91" * 100_000):
        assert unpack(session.answer(frame))["type"] == "error"


def test_what_the_protocol_does_not_hold_is_refused() -> None:
    policy: Any = Counts(np.zeros(14))
    policy.control_options = {"observation": "rgbd"}
    with pytest.raises(InvalidConfigError, match="have only images and joints"):
        PolicyServer(policy, port=0, protocol="vla-eval")
    with pytest.raises(UnknownNameError, match="protocol"):
        PolicyServer(policy, port=0, protocol="carrier pigeon")
