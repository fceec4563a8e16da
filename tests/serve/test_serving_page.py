"""The code follows the protocol that docs/serving.md describes."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest
from faulty_policies import MOVE, given, moved, view

from lemma.core.poses import Pose2
from lemma.env.episode import Episode
from lemma.evaluation.run.fault_isolation import FARTHEST_M
from lemma.evaluation.run.server_check import NEAR_M, NEAR_RAD, SCENE, first_subtask
from lemma.expert.expert import Expert
from lemma.planning.symbolic_state import SymbolicState
from lemma.policies.interfaces import TIMEOUT_S, Decision, PastStep, PolicyInput
from lemma.scene.raster import RASTER
from lemma.serve.arrays import VIEW_ARRAYS, ViewMessage
from lemma.serve.conversation import Conversation, ProtocolMode, remote
from lemma.serve.faults import FaultKind
from lemma.serve.messages import (
    PROTOCOL,
    Decisions,
    Hello,
    InputMessage,
    StepMessage,
    decode_reply,
    decode_request,
    encode,
)
from lemma.serve.session import Session
from lemma.serve.websocket import connect
from lemma.tasks.subtask import STOP, Primitive, SubTask
from lemma.tasks.suite import load_instance

PAGE_PATH = Path(__file__).parents[2] / "docs/serving.md"
PAGE = PAGE_PATH.read_text()


def section(title: str) -> str:
    return re.split(r"^#{2,3} ", PAGE.partition(f"# {title}\n")[2], flags=re.M)[0]


def first_cells(text: str) -> list[str]:
    rows = re.findall(r"^\| (.*?) \|", text, re.MULTILINE)
    return [row.strip("`") for row in rows]


def fields(message: str) -> set[str]:
    """Return the fields of a message or an answer, from the tables."""
    found, current = set(), ""
    for first, second in re.findall(r"^\| (.*?) ?\| (.*?) ?\|", PAGE, re.MULTILINE):
        current = first or current
        if re.search(rf"`{message}`", current) and second.startswith("`"):
            found |= set(re.findall(r"`(\w+)`", second))
    return found


def test_the_kinds_of_faults_are_listed() -> None:
    cells = first_cells(section("Faults"))
    assert cells[-len(FaultKind) :] == [str(kind) for kind in FaultKind]
    assert f"more than {FARTHEST_M:g} m away" in PAGE
    assert f"({TIMEOUT_S:g} s per decision" in PAGE
    mode = ProtocolMode(1.0)
    assert f"for up to {mode.patience_s:g} s" in PAGE
    assert mode.deaths == 3


def test_the_known_question_and_its_answer_are_printed() -> None:
    text = section("One known question")
    instance = load_instance(*SCENE)
    assert f"instruction  {instance.instructions['high_level']}\n" in text
    colors = ", ".join(f"{robot.color} robot" for robot in instance.scene.robots)
    assert f"robots       {colors}: " in text
    for name, robot in zip(("robot_0", "robot_1"), instance.scene.robots, strict=True):
        assert f"{name} at x = {robot.base.x:.3f} m" in text
    scene = Episode(instance).simulation.scene
    for cube, at in SymbolicState.observe(scene).poses.items():
        told = f"x = {at.x:.3f} m, y = {at.y:.3f} m, yaw = {at.yaw:.3f} rad"
        assert re.search(rf"{cube} +{re.escape(told)}", text)
    plan = Expert(scene, instance.goal).plan()
    assert plan is not None
    [printed] = re.findall(r"^```json\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    answer = {"type": "decisions", "decisions": [json.loads(printed)]}
    reply = decode_reply(msgpack.packb(answer))
    assert isinstance(reply, Decisions)
    [decision] = reply.decisions
    right = plan.steps[0].grounded
    assert decision.subtask == plan.steps[0].subtask == first_subtask()
    assert decision.grounded == replace(
        right, pick=right.pick.rounded(3), place=right.place.rounded(3)
    )
    assert set(first_cells(text)) >= {"pick", "robot", "heading"}
    assert f"within {100 * NEAR_M:g} cm" in text
    assert f"within {NEAR_RAD:g} rad" in text


def test_the_view_is_described() -> None:
    every = re.findall(r"^\| `(\w+)` \| `(\w+)` \| ([^|]*) \|", PAGE, re.MULTILINE)
    types = {dtype for dtype, _ in VIEW_ARRAYS.values()}
    rows = [row for row in every if row[1] in types]
    assert {name: (dtype, len(shape.split(","))) for name, dtype, shape in rows} == (
        VIEW_ARRAYS
    )
    assert f"| {RASTER.rows}, {RASTER.columns}, 3 |" in PAGE
    assert f"(column + 0.5 - {RASTER.columns // 2}) * {RASTER.cell_m}" in PAGE
    assert f"({RASTER.rows // 2} - row - 0.5)" in PAGE


class Does:
    """Decides nothing, in three ways."""

    def act(self, inputs: list[PolicyInput]) -> list[Decision]:
        return [moved() for _ in inputs]

    def plan(self, inputs: list[PolicyInput]) -> list[SubTask]:
        return [STOP for _ in inputs]

    def ground(self, inputs: list[PolicyInput], subtasks: list[SubTask]) -> list[None]:
        return [None for _ in inputs]


class Listens:
    """A channel to a session in this process, which keeps what is said."""

    def __init__(self, log: list[Any]) -> None:
        self.session, self.log = Session(Does()), log
        self.reply = b""

    def send(self, message: bytes) -> None:
        self.reply = self.session.answer(message)
        self.log += [decode_request(message), decode_reply(self.reply)]

    def receive(self, timeout_s: float) -> bytes:
        return self.reply

    def close(self) -> None: ...


def test_the_messages_are_described() -> None:
    log: list[Any] = []
    policy: Any = remote(Conversation("here", lambda: Listens(log), ProtocolMode(60.0)))
    policy.act([given("go", PastStep(view(1), MOVE))])
    policy.plan([given()])
    policy.ground([given()], [MOVE])
    log.append(decode_reply(Session(Does()).answer(encode(Hello(protocol=0)))))
    said: dict[str, set[str]] = {}
    for message in log:
        kind = message.__struct_config__.tag
        said.setdefault(kind, set()).update(message.__struct_fields__)
    assert set(said) == {
        *("hello", "act", "plan", "ground", "decisions", "subtasks", "poses", "error"),
    }
    for kind, names in said.items():
        if kind != "error":
            assert fields(kind) >= names, kind
            # `ground` shares its row with `act` and `plan`, which have no sub-tasks.
            assert fields(kind) - names <= {"subtasks"}, kind
    told = section("act, plan, ground")
    assert set(first_cells(told)) >= {
        *InputMessage.__struct_fields__,
        *ViewMessage.__struct_fields__,
    }
    assert all(f"`{name}`" in told for name in StepMessage.__struct_fields__)
    assert f"Version {PROTOCOL}." in PAGE
    types = {dtype for dtype, _ in VIEW_ARRAYS.values()}
    for name in (*types, *Primitive, "error", "kind", "message", "request"):
        assert f"`{name}`" in PAGE


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@contextmanager
def own_server(folder: Path) -> Iterator[str]:
    """Run the server of the page, which knows nothing of this package."""
    own = (PAGE_PATH.parent / "own_server.py").read_text()
    assert "import lemma" not in own
    assert "from lemma" not in own
    assert len(own.splitlines()) <= 60
    script = folder / "own.py"
    script.write_text(own)
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(script), "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield f"http://127.0.0.1:{int(process.stdout.readline())}"
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def test_a_server_of_ones_own_decides(tmp_path: Path) -> None:
    rows, columns = RASTER.rows, RASTER.columns
    low, high = view(1, rows, columns), view(1, rows, columns)
    high.height_m[100, 300] = 0.2
    low.height_m[200, 10] = 0.1
    with own_server(tmp_path) as url:
        policy: Any = connect(url, ProtocolMode(60.0))
        assert policy.about == {"name": "highest"}
        past = PastStep(low, MOVE)
        for _ in range(2):
            found = policy.act(
                [
                    given("a", now=low),
                    given("b", past, now=high),
                    given("c", past, past, now=high),
                ]
            )
            assert [one.subtask.robot for one in found] == ["robot_0", "robot_1", ""]
            assert found[1].grounded.pick.rounded() == Pose2(0.74, 0.86, 0.0)
            assert found[2].subtask == STOP
        policy.close()


@pytest.mark.parametrize("number", [0])
def test_the_short_server_is_a_policy(number: int) -> None:
    names: dict[str, Any] = {"__name__": "page"}
    exec(compile(blocks()[number], "serving.md", "exec"), names)
    policy = names["MyPolicy"]()
    assert [d.subtask for d in policy.act([given()])] == [STOP]
    assert Session(policy).methods == ["act"]
