"""What docs/serving.md says of the protocol is what the code does."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from faulty_policies import MOVE, given, moved, view

from lemma.evaluation.run.fault_isolation import FARTHEST_M
from lemma.policies.interfaces import Decision, PastStep, PolicyInput
from lemma.policies.spec import TIMEOUT_S
from lemma.serve.client.conversation import Conversation, ProtocolMode
from lemma.serve.client.remote import remote
from lemma.serve.client.websocket import connect
from lemma.serve.protocol.faults import FaultKind
from lemma.serve.protocol.messages import PROTOCOL, VIEW_TYPES, Message
from lemma.serve.protocol.packing import DTYPES
from lemma.serve.selftest.echo import CELL_M
from lemma.serve.selftest.known_inputs import (
    CHECKS,
    COLUMNS,
    ROWS,
    check,
    golden_message,
)
from lemma.serve.server.session import Session
from lemma.tasks.subtask import STOP, Primitive, SubTask

PAGE = (Path(__file__).parents[2] / "docs/serving.md").read_text()


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
    assert first_cells(section("What goes wrong, and what it costs"))[-6:] == [
        str(kind) for kind in FaultKind
    ]
    assert f"more than {FARTHEST_M:g} m away" in PAGE
    assert f"({TIMEOUT_S:g} s per decision" in PAGE
    manners = ProtocolMode(1.0)
    assert f"for up to {manners.patience_s:g} s" in PAGE
    assert manners.deaths == 3


def test_the_checks_are_listed() -> None:
    assert tuple(first_cells(section("The self-test"))[1:]) == CHECKS


def test_the_view_is_described() -> None:
    every = re.findall(r"^\| `(\w+)` \| `(\w+)` \| ([^|]*) \|", PAGE, re.MULTILINE)
    rows = [row for row in every if row[1] in DTYPES]
    assert {name: dtype for name, dtype, _ in rows} == {
        name: "bool" if dtype.__name__.startswith("bool") else dtype.__name__
        for name, (dtype, _) in VIEW_TYPES.items()
    }
    for name, _, shape in rows:
        assert len(shape.split(",")) == VIEW_TYPES[name][1]
    assert f"| {ROWS}, {COLUMNS}, 3 |" in PAGE
    assert f"(column + 0.5 - {COLUMNS // 2}) * {CELL_M}" in PAGE
    assert f"({ROWS // 2} - row - 0.5)" in PAGE


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

    def __init__(self, log: list[Message]) -> None:
        self.session, self.log = Session(Does()), log

    def send(self, message: Message) -> None:
        self.log += [message, self.session.answer(message)]

    def receive(self, timeout_s: float) -> Message:
        return self.log[-1]

    def close(self) -> None: ...


def test_the_messages_are_described() -> None:
    log: list[Message] = []
    policy: Any = remote(Conversation("here", lambda: Listens(log), ProtocolMode(60.0)))
    past = PastStep(view(1), MOVE)
    policy.act([given("go", past)])
    policy.plan([given()])
    policy.ground([given()], [MOVE])
    log[0:0] = [Session(Does()).answer(log[4])]
    policy.conversation.ask(golden_message(), 60.0)
    said: dict[str, set[str]] = {}
    for message in log:
        said.setdefault(message["type"], set()).update(set(message) - {"type", "id"})
    assert set(said) == {
        *("hello", "reset", "ready", "act", "plan", "ground", "decisions", "subtasks"),
        *("poses", "missing", "check", "checked"),
    }
    for kind, names in said.items():
        assert fields(kind) >= names, kind
        # `ground` shares its row with `act` and `plan`, which have no sub-tasks.
        assert fields(kind) - names <= {"subtasks"}, kind
    asked = next(m for m in log if m["type"] == "act")["inputs"][0]
    assert set(first_cells(section("act, plan, ground"))) >= set(asked)
    assert set(asked["past"][0]) == {"view", "subtask", "outcome"}
    assert f"Version {PROTOCOL}." in PAGE
    for name in (*DTYPES, *Primitive, "unsupported", "error"):
        assert f"`{name}`" in PAGE


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_a_server_of_ones_own_passes_the_test_and_decides(tmp_path: Path) -> None:
    [own] = [block for block in blocks() if "import msgpack" in block]
    script = tmp_path / "own.py"
    script.write_text(own)
    process = subprocess.Popen(
        [sys.executable, "-W", "error", str(script), "0"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        url = f"http://127.0.0.1:{int(process.stdout.readline())}"
        policy: Any = connect(url, ProtocolMode(60.0))
        report = check(policy.conversation)
        assert report.ok, str(report)
        assert report.by == "my server"
        decisions = policy.act([given(), given("more")])
        assert [decision.subtask for decision in decisions] == [STOP, STOP]
        policy.close()
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize("number", [0])
def test_the_short_server_is_a_policy(number: int) -> None:
    names: dict[str, Any] = {"__name__": "page"}
    exec(compile(blocks()[number], "serving.md", "exec"), names)
    policy = names["MyPolicy"]()
    assert [d.subtask for d in policy.act([given()])] == [STOP]
    assert Session(policy).methods == ["act"]
