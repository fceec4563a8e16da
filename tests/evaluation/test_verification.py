"""Results played again without their policy: honest ones stand, forged ones do not."""

import json
import lzma
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from clumsy import EPISODES, KINDS, played_clumsily
from command import run
from tiers import slow_but

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import Serial
from lemma.evaluation.analysis.result import summarise
from lemma.evaluation.experiments.catalog import CONTROL_LEVEL, EXPERIMENTS
from lemma.evaluation.lines import read_lines, write_packed, write_rows
from lemma.evaluation.records import ABOUT, PACKED, SUMMARY, read_about
from lemma.evaluation.records import EPISODES as LINES
from lemma.evaluation.run.evaluate import start_of
from lemma.evaluation.run.replay import differences, play_again
from lemma.evaluation.verification import Verification, copies, verify
from lemma.tasks.instance import Instance

RESULTS = Path(__file__).parents[2] / "results"
PUBLISHED = sorted(RESULTS.rglob(f"*{PACKED}"))
REPLAYED = "reachnet/seed-0.jsonl.xz"
MOST_UNPACKED = 10_000_000
"""Bytes that a file may unpack to in these tests."""
SOLVED, EARLY, MISSED, STOPPED = range(EPISODES)
"""The outcome that the policy reached on each instance."""
Data = dict[str, Any]


def is_control(path: Path) -> bool:
    """Whether a result is of motor commands, which no line holds."""
    entry = EXPERIMENTS.get(path.parent.name)
    return entry is not None and entry.suite == CONTROL_LEVEL


def one_of_each(published: Sequence[Path]) -> list[str]:
    """Return results that were made in different ways: one of each, by path.

    They differ in whether the policy knows the truth, in where objects start and in
    what the policy is told. The two best known come first.
    """
    found: dict[tuple[object, ...], str] = {}
    first = ("reachnet", "oracle")
    for path in sorted(published, key=lambda each: each.parent.name not in first):
        if not is_control(path):
            about = read_about(path)
            way = (about["oracle"], about["perturb_start"], about["language"])
            found.setdefault(way, str(path.relative_to(RESULTS)))
    return list(found.values())


@pytest.fixture
def honest() -> Path:
    return played_clumsily()


@dataclass
class Forgery:
    """A change that somebody made to a result before it was handed in."""

    line: Callable[[Data], object] = lambda row: None
    """Changes the line of one episode."""
    of: int = SOLVED
    """Which one."""
    about: Data = field(default_factory=dict)
    policy: Data = field(default_factory=dict)
    command: str = ""
    """Of the summary; none is handed in where this is empty."""
    why: str = "when played again"
    """Words of the refusal."""

    def write(self, honest: Path, folder: Path) -> Path:
        rows = [deepcopy(dict(row)) for row in read_lines(honest / LINES)]
        chosen = [row for row in rows if row["index"] == self.of][:1]
        for row in chosen:
            self.line(row)
        about = {**read_about(honest), **self.about}
        about["policy"] = {**about["policy"], **self.policy}
        folder.mkdir(exist_ok=True)
        (folder / ABOUT).write_text(json.dumps(about))
        kept = rows if self.command else chosen
        write_rows(folder / LINES, kept)
        if self.command:
            summarise(kept, about, self.command).write(folder / SUMMARY)
        return folder / LINES


def succeed(row: Data) -> None:
    row.update(success=True, failure=None, progress=1.0)
    row["lenient"].update(success=True, failure=None, progress=1.0)


def at_once(row: Data) -> None:
    succeed(row)
    row.update(subtasks=[], elapsed_s=0.0)
    row["lenient"].update(subtasks=[], elapsed_s=0.0)


def succeed_in_spite_of_the_stop(row: Data) -> None:
    row["success"] = row["lenient"]["success"] = True


def lenient_as_strict(row: Data) -> None:
    row["subtasks"] += row["lenient"]["subtasks"]
    row.update(success=True, failure=None, progress=1.0)
    row["lenient"].update(success=True, subtasks=[])


def step(row: Data, number: int = 0) -> Data:
    found: Data = row["subtasks"][number]
    return found


FORGERIES = {
    "every success set to true, sub-tasks left as failed": Forgery(succeed, MISSED),
    "stopped early, and yet solved": Forgery(succeed, EARLY),
    "success without any sub-task, after 0 s": Forgery(at_once, EARLY),
    "lenient verdict written as the strict one": Forgery(lenient_as_strict, STOPPED),
    "success with a protective stop": Forgery(succeed_in_spite_of_the_stop, STOPPED),
    "failure without a protective stop": Forgery(
        lambda row: row.update(failure="goal_not_reached"), STOPPED
    ),
    "another team": Forgery(lambda row: row.update(team="ur5+ur3")),
    "minus five distractors": Forgery(lambda row: row.update(distractors=-5)),
    "more progress": Forgery(lambda row: row.update(progress=0.75), EARLY),
    "more of the goal": Forgery(lambda row: row.update(goal_progress=0.5), EARLY),
    "a later stage": Forgery(lambda row: row["stages"].update(subtask=1), EARLY),
    "a better verdict on the first move": Forgery(
        lambda row: row["stages"].update(understood=True, moved="blue_cube"), MISSED
    ),
    "a shorter time": Forgery(lambda row: row.update(elapsed_s=1.0)),
    "no idle time": Forgery(lambda row: row["idle_s"].update(robot_0=0.0)),
    "a faster expert": Forgery(lambda row: row["coordination"].update(expert_s=99.0)),
    "better allocation": Forgery(
        lambda row: row["coordination"].update(able=9, doable=9), STOPPED
    ),
    "a sub-task that succeeded": Forgery(
        lambda row: step(row).update(outcome="success"), MISSED
    ),
    "a sub-task left out": Forgery(lambda row: row["subtasks"].pop(0)),
    "a refused sub-task left out": Forgery(lambda row: row["subtasks"].pop(), STOPPED),
    "a pose moved": Forgery(
        lambda row: step(row)["grounded"].update(pick=[0.1, 0.1, 0.0])
    ),
    "an exact pose": Forgery(
        lambda row: step(row)["expert"].update(pick_error_mm=0.0), MISSED
    ),
    "the expert's sub-task": Forgery(
        lambda row: step(row)["expert"].update(departure=""), STOPPED
    ),
    "another sentence": Forgery(lambda row: row.update(instruction="Do it.")),
    "another goal that was asked for": Forgery(
        lambda row: row.update(asked=[["red_cube", "red_pad"]])
    ),
    "an error of the policy that was none": Forgery(
        lambda row: row["lenient"].update(
            policy_error={"kind": "raised", "explanation": "x"}
        )
    ),
    "another state": Forgery(lambda row: row.update(state_sha256="0" * 64)),
    "the perturbed start of one": Forgery(
        lambda row: row.update(perturb_start=True), why="another perturb_start"
    ),
    "an episode of another list": Forgery(
        lambda row: row.update(split="test"), why="another split"
    ),
    "an episode of no list": Forgery(
        lambda row: row.update(index=10**9), why="cannot be played"
    ),
    "no lenient verdict in one": Forgery(
        lambda row: row.update(lenient=None), why="verdicts"
    ),
    "motor commands that are none": Forgery(
        policy={"level": "control"}, why="no motor commands"
    ),
    "another protocol": Forgery(about={"protocol": "0" * 64}, why="follows protocol"),
    "another horizon": Forgery(about={"horizon_s": 1e9}, why="horizon"),
    "ground-truth allocation hidden": Forgery(
        command="lemma evaluate --policy clumsy:Clumsy --gta", why="ground-truth"
    ),
    "ground-truth allocation among learned": Forgery(
        about={"oracle": False}, policy={"gta": True}, why="knows the truth"
    ),
    "the expert's poses among learned": Forgery(
        about={"oracle": False}, policy={"name": "reachnet+oracle"}, why="knows the"
    ),
    "a planner with the expert's poses among learned": Forgery(
        about={"oracle": False}, policy={"name": "greedy-reach"}, why="knows the truth"
    ),
    "a privileged checkpoint among learned": Forgery(
        about={"oracle": False},
        policy={"name": "lerobot-privileged:act"},
        why="knows the truth",
    ),
    "no weights of a model": Forgery(policy={"name": "reachnet"}, why="no weights"),
}


DECIDED = ("robot", "primitive", "pick", "place", "grounded", "explanation")
EXECUTED: dict[str, Data] = {}
"""Lines that executions came to, by all that an execution reads of a line."""


@pytest.fixture
def executes_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most forgeries leave the decisions as they were: execute those once."""

    def play(row: Data, instance: Instance, about: Data) -> Data:
        lenient = row["lenient"]
        steps = [row["subtasks"], [] if lenient is None else lenient["subtasks"]]
        decided = [[[one[name] for name in DECIDED] for one in part] for part in steps]
        ends = [lenient is None, (lenient or row)["policy_error"]]
        kind = [row["instruction_kind"], row["perturb_start"], about["horizon_s"]]
        told = json.dumps([instance.sha256(), *kind, decided, ends])
        if told not in EXECUTED:
            EXECUTED[told] = dict(play_again(row, instance, about))
        return deepcopy(EXECUTED[told])

    monkeypatch.setattr("lemma.evaluation.verification.play_again", play)


@pytest.mark.usefixtures("executes_once")
@pytest.mark.parametrize("what", FORGERIES)
def test_forgeries_are_refused(what: str, honest: Path, tmp_path: Path) -> None:
    forgery = FORGERIES[what]
    found = verify(forgery.write(honest, tmp_path / "forged"), Serial())
    assert not found.ok
    assert any(forgery.why in problem for problem in found.problems), found.problems


def test_an_honest_result_stands(honest: Path) -> None:
    found = verify(honest / LINES, Serial())
    assert found.problems == ()
    assert found.played == found.episodes == EPISODES * len(KINDS)
    assert found.knows_truth
    assert not found.complete
    assert verify(honest / LINES, Serial(), episodes=1).played == len(KINDS)


def code_of(*words: object) -> object:
    return run("verify", *words, "--workers", 1)


def test_a_class_in_the_process_of_the_evaluation_may_know_the_truth(
    honest: Path, tmp_path: Path
) -> None:
    hidden = Forgery(about={"oracle": False}).write(honest, tmp_path / "hidden")
    assert verify(hidden, Serial()).knows_truth
    apart = Forgery(about={"oracle": False}, policy={"timeout_s": 30.0})
    assert not verify(apart.write(honest, tmp_path / "apart"), Serial()).knows_truth


def test_the_verb_says_which_stand(
    honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    forged = Forgery(succeed, MISSED).write(honest, tmp_path / "[red]forged")
    assert code_of(honest, forged, "--episodes", 1, "--json") == 1
    one, other = json.loads(capsys.readouterr().out)["results"]
    assert (one["ok"], other["ok"]) == (True, False)
    assert code_of(forged) == 1
    text = capsys.readouterr().out
    assert "REFUSED" in text
    assert "[red]forged" in text
    assert code_of(honest, "--episodes", 1) == 0


def test_lines_that_do_not_give_the_summary_are_refused(
    honest: Path, tmp_path: Path
) -> None:
    forged = Forgery(command="lemma evaluate").write(honest, tmp_path / "forged")
    rows = read_lines(forged)
    write_rows(forged, rows[1:])
    assert "does not fit the lines" in verify(forged, Serial()).problems[0]
    write_rows(forged, [rows[0], *rows])
    assert "twice" in verify(forged, Serial()).problems[0]


def test_lines_of_another_policy_are_seen() -> None:
    first = Verification(Path("a"), (), digest="1" * 64, policy="reachnet")
    again = Verification(Path("b"), (), digest="1" * 64, policy="mine")
    other = Verification(Path("c"), (), digest="2" * 64, policy="mine")
    assert [one.ok for one in copies([first, again, other])] == [True, False, True]


def test_there_are_published_lines() -> None:
    assert PUBLISHED, f"No result in {RESULTS} has its lines beside it."


@pytest.mark.parametrize("name", slow_but(one_of_each(PUBLISHED), REPLAYED))
def test_published_lines_are_played_again_to_the_bit(name: str) -> None:
    path = RESULTS / name
    about, rows = read_about(path), read_lines(path)
    for row in rows[7::1280]:
        again = json.loads(json.dumps(play_again(row, start_of(row), about)))
        assert list(differences(row, again)) == []


@pytest.mark.slow
@pytest.mark.parametrize("path", PUBLISHED, ids=str)
def test_published_results_stand(path: Path) -> None:
    found = verify(path, Serial(), episodes=1, seed=7)
    if is_control(path):
        assert "cannot be verified" in found.problems[0]
    else:
        assert found.problems == ()


def test_what_is_sent_is_read_within_limits(
    honest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lemma.evaluation.lines.MOST_UNPACKED", MOST_UNPACKED)
    rows = read_lines(honest / LINES)
    many = [{**rows[0], "index": i} for i in range(200)]
    packed = tmp_path / f"many{PACKED}"
    text = "".join(json.dumps(row) + "\n" for row in [*many, many[-1]])
    packed.write_bytes(lzma.compress(text.encode(), preset=0))
    with pytest.raises(DatasetError, match="twice"):
        read_lines(packed)
    packed.write_bytes(lzma.compress(b"\n" * (MOST_UNPACKED + 1), preset=0))
    with pytest.raises(DatasetError, match="cannot be read"):
        read_lines(packed)
    packed.write_bytes(lzma.compress(b" " * 3_000_000, preset=0))
    with pytest.raises(DatasetError, match="longer than"):
        read_lines(packed)
    write_packed(packed, rows)
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(DatasetError, match="cannot be read"):
        read_lines(packed)
    too_much: list[Data] = [
        {"more": [[]] * 9},
        {"idle_s": {str(i): 0.0 for i in range(2000)}},
    ]
    for more in too_much:
        write_rows(tmp_path / LINES, [{**rows[0], **more}])
        with pytest.raises(DatasetError, match="cannot be read"):
            read_lines(tmp_path / LINES)
