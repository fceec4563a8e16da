"""A policy behind a socket plays the same episodes as in this process, to the byte."""

import json
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from faulty_policies import Scripted, end, given, start

from lemma.cli.evaluate import EvaluateOptions
from lemma.cli.evaluate import evaluate as verb
from lemma.cli.options import complain
from lemma.cli.serve import serve as serve_verb
from lemma.cli.workers import Workers
from lemma.core.errors import InvalidConfigError
from lemma.core.workers.pool import Job, Listener, ProcessPool, Serial, ignore
from lemma.evaluation.lines import read_rows
from lemma.evaluation.records import ABOUT, EPISODES, Row
from lemma.evaluation.run import loading
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.policies.spec import PolicySpec
from lemma.serve.conversation import ProtocolMode
from lemma.serve.faults import PolicyUnreachableError
from lemma.serve.server import PolicyServer

pytestmark = pytest.mark.render


class Here(Workers):
    """Works in this process."""

    def make_engine(self) -> Serial:
        return Serial()


NAME = "faulty_policies:Scripted"


def order(out: Path, policy: str, **changes: Any) -> EvaluationConfig:
    wanted = {"tasks": ("pass", "stack2"), "episodes": 3, **changes}
    spec = PolicySpec(policy, timeout_s=changes.pop("timeout_s", 60.0))
    wanted.pop("timeout_s", None)
    return EvaluationConfig(out=out, policy=spec, **wanted)


def lines(folder: Path) -> list[Row]:
    rows = [json.loads(text) for text in (folder / EPISODES).read_text().splitlines()]
    return without_times(rows)


def without_times(rows: Sequence[Row]) -> list[Row]:
    return [{k: v for k, v in row.items() if k != "wall_s"} for row in rows]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    folder = tmp_path_factory.mktemp("here")
    evaluate(order(folder, NAME, timeout_s=0.0), Serial())
    found = lines(folder)
    assert len(found) == 6
    assert all(len(row["subtasks"]) == 2 for row in found)
    assert {row["failure"] for row in found} != {None}
    return found


@pytest.mark.slow
def test_a_socket_gives_the_same_lines_to_two_processes(
    tmp_path: Path, here: list[Row]
) -> None:
    with PolicyServer(Scripted(), port=0, about={"weights": "abc"}) as server:
        evaluate(order(tmp_path, server.url), ProcessPool(2))
        about = json.loads((tmp_path / ABOUT).read_text())
        assert about["served"] == {
            server.url: {"name": "Scripted", "weights": "abc"},
        }
    assert lines(tmp_path) == here


@pytest.mark.slow
def test_a_process_gives_the_same_lines(tmp_path: Path, here: list[Row]) -> None:
    evaluate(order(tmp_path, NAME), Serial())
    assert lines(tmp_path) == here


class Restarts:
    """An engine that kills the server while the first group plays, and starts it."""

    workers = 1

    def __init__(self, url: str, process: Any) -> None:
        self.port, self.process = int(url.rpartition(":")[2]), process

    def run(
        self, function: Any, jobs: Sequence[Job], on_report: Listener = ignore
    ) -> Iterator[Any]:
        for job in jobs:
            killing = threading.Thread(target=self.restart)
            killing.start()
            yield function(*job)
            killing.join()

    def restart(self) -> None:
        # Somewhere in the middle: a group takes a second and more.
        threading.Event().wait(0.6)
        end(self.process)
        self.process, _ = start("Scripted", self.port)


@pytest.mark.slow
def test_a_server_killed_in_the_middle_gives_the_same_lines(
    tmp_path: Path, here: list[Row]
) -> None:
    process, url = start("Scripted")
    engine = Restarts(url, process)
    try:
        evaluate(order(tmp_path, url), engine)
    finally:
        end(engine.process)
    assert lines(tmp_path) == here


@pytest.mark.slow
def test_a_server_gone_for_good_ends_the_run_and_keeps_what_was_done(
    tmp_path: Path, here: list[Row], monkeypatch: pytest.MonkeyPatch
) -> None:
    impatient = ProtocolMode(60.0, patience_s=0.3, first_patience_s=0.3)
    monkeypatch.setattr(loading, "ProtocolMode", lambda timeout_s: impatient)
    with PolicyServer(Scripted(), port=0) as server:

        class Closes(Serial):
            def run(
                self, function: Any, jobs: Any, on_report: Any = None
            ) -> Iterator[Any]:
                yield function(*jobs[0])
                server.close()
                yield from super().run(function, jobs[1:], on_report)

        with pytest.raises(PolicyUnreachableError, match="same command again"):
            evaluate(order(tmp_path, server.url), Closes())
    assert without_times(read_rows(tmp_path)) == here[:3]
    with PolicyServer(Scripted(), port=server.port) as again:
        assert again.url == server.url
        evaluate(order(tmp_path, again.url), Serial())
    assert lines(tmp_path) == here


def test_the_verb_says_what_it_cannot_serve() -> None:
    for policy in ("oracle", "reachnet+oracle"):
        with pytest.raises(InvalidConfigError, match="simulation's state"):
            serve_verb(policy)
    both: tuple[Any, Any] = ("reachnet", "http://127.0.0.1:1")
    for words in (both, (None, None)):
        with pytest.raises(InvalidConfigError, match="either"):
            serve_verb(words[0], check=words[1])


def test_a_server_may_take_any_time() -> None:
    with PolicyServer(Scripted(), port=0) as server:
        policy: Any = loading.load_policy(PolicySpec(server.url, timeout_s=0.0))
        assert len(policy.act([given()])) == 1
        policy.close()


def test_names_of_classes_are_shown_as_they_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    complain("There is no nope:X: it is missing.")
    assert "nope:X: it" in capsys.readouterr().err


def test_faults_are_named_on_the_screen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ask = EvaluateOptions(tasks="stack", episodes=2, timeout_s=60.0)
    assert verb("faulty_policies:AnswersNothing", tmp_path, ask, Here()) == 0
    told = capsys.readouterr().err
    assert "stack 0: malformed: The policy's answer cannot be used" in told
    assert "2 of 2 episodes failed because of an error" in told
