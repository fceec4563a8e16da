"""Evaluation: the same lines however it was interrupted, and honest about failures."""

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch
from command import run
from made_up import timeless

from lemma.core import plugins
from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.core.workers.resumable import begin
from lemma.evaluation.analysis.rates import wilson_interval
from lemma.evaluation.lines import read_rows
from lemma.evaluation.protocol.rules import quote
from lemma.evaluation.records import ABOUT, EPISODES, Row
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.evaluation.run.loading import load_policy
from lemma.policies import spec as specs
from lemma.policies.planners.chat import ChatOptions
from lemma.policies.spec import PolicySpec
from lemma.policies.weights import load_model
from lemma.tasks.suite import SUITE, load_instance

TASKS = ("stack", "pass")


def order(
    out: Path, policy: str | PolicySpec = "oracle", **changes: Any
) -> EvaluationConfig:
    spec = PolicySpec(policy) if isinstance(policy, str) else policy
    wanted = {"tasks": TASKS, "episodes": 2, "kinds": ("high_level",), **changes}
    return EvaluationConfig(out=out, policy=spec, **wanted)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    return evaluate(order(tmp_path_factory.mktemp("whole")), Serial())


@pytest.mark.slow
def test_the_expert_succeeds_in_every_line(whole: list[Row]) -> None:
    assert len(whole) == 4
    assert all(row["success"] and row["progress"] == 1.0 for row in whole)
    assert {row["failure"] for row in whole} == {None}
    # In the order of the suite, not in that of the request.
    assert [row["task"] for row in whole] == ["pass"] * 2 + ["stack"] * 2
    assert [row["index"] for row in whole] == [*range(2)] * 2


def test_interrupted_and_resumed_gives_the_same(
    tmp_path: Path, whole: list[Row]
) -> None:
    counts: list[int] = []

    def hear(count: int) -> None:
        counts.append(count)
        # The episode that is told of last is not kept.
        if len(counts) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate(order(tmp_path), Serial(), hear)
    # A whole group and a part of the next are kept.
    assert counts == [0] + [1] * 4
    kept = read_rows(tmp_path)
    assert len(kept) == 3
    equal = {(row["task"], row["index"]): row for row in timeless(whole)}
    for row in timeless(kept):
        assert row == equal[row["task"], row["index"]]
    counts.clear()
    rows = evaluate(order(tmp_path), Serial(), counts.append)
    assert timeless(rows) == timeless(whole)
    assert sum(counts) == 4
    assert counts[0] == 2
    lines = (tmp_path / EPISODES).read_text().splitlines()
    assert [json.loads(line) for line in lines] == rows


@pytest.mark.slow
def test_processes_give_the_same(tmp_path: Path, whole: list[Row]) -> None:
    rows = evaluate(order(tmp_path), ProcessPool(2))
    assert timeless(rows) == timeless(whole)


@pytest.mark.slow
def test_a_result_grows_with_what_is_asked(tmp_path: Path) -> None:
    evaluate(order(tmp_path, tasks=("stack",), episodes=1), Serial())
    wider = order(tmp_path, tasks=TASKS, episodes=2, kinds=("high_level", "human"))
    rows = evaluate(wider, Serial())
    assert len(rows) == 8
    assert {row["instruction_kind"] for row in rows} == {"high_level", "human"}


def test_results_of_different_policies_are_not_mixed(tmp_path: Path) -> None:
    evaluate(order(tmp_path, tasks=("stack",), episodes=1), Serial())
    other = EvaluationConfig(out=tmp_path, policy=PolicySpec("oracle", "multi-step"))
    with pytest.raises(DatasetError, match="policy"):
        evaluate(other, Serial())
    assert json.loads((tmp_path / ABOUT).read_text())["split"] == "test"


def test_a_run_that_played_nothing_may_be_begun_otherwise(tmp_path: Path) -> None:
    def fail(count: int) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        evaluate(order(tmp_path, "noisy-oracle:0.9"), Serial(), fail)
    assert (tmp_path / ABOUT).exists()
    rows = evaluate(order(tmp_path, tasks=("stack",), episodes=1), Serial())
    assert len(rows) == 1
    assert json.loads((tmp_path / ABOUT).read_text())["policy"]["name"] == "oracle"


def test_another_protocol_is_refused(tmp_path: Path) -> None:
    evaluate(order(tmp_path, tasks=("stack",), episodes=1), Serial())
    note = tmp_path / ABOUT
    about = json.loads(note.read_text())
    assert about["protocol"] == quote()
    note.write_text(json.dumps({**about, "protocol": "6" * 64}))
    with pytest.raises(DatasetError, match="follows 666"):
        evaluate(order(tmp_path, tasks=("stack",), episodes=1), Serial())


def test_the_expert_is_as_fast_as_the_expert(whole: list[Row]) -> None:
    for row in whole:
        told = row["coordination"]
        assert row["elapsed_s"] == told["expert_s"]
        assert told["able"] == told["doable"] == told["as_expert"] == told["planned"]
        assert told["doable"] == len(row["subtasks"])
        assert told["order_violations"] == 0
        assert 0.0 < told["clearance_mm"] < 2000.0
        assert (row["asked"], row["asked_holds"]) == (None, None)


@pytest.mark.slow
def test_the_expert_ignores_what_is_said(tmp_path: Path) -> None:
    rows = evaluate(order(tmp_path, language="swapped"), Serial())
    assert all(row["success"] for row in rows)
    assert [row["asked_holds"] for row in rows if row["asked"]] == [False] * sum(
        row["asked"] is not None for row in rows
    )
    for row in rows:
        own = load_instance(row["task"], "test", row["index"])
        assert row["instruction"] != own.instructions["high_level"]


@pytest.mark.slow
def test_perturbed_starts_are_solved_too(tmp_path: Path) -> None:
    wanted = order(tmp_path, perturb_start=True)
    assert wanted.command().endswith("--episodes 2 --perturb-start")
    rows = evaluate(wanted, Serial())
    assert all(row["success"] for row in rows)
    assert [row["elapsed_s"] for row in rows] == [
        row["coordination"]["expert_s"] for row in rows
    ]


@pytest.mark.parametrize(
    "wrong",
    [
        {"tasks": ("juggle",)},
        {"split": "exam"},
        {"kinds": ("sung",)},
        {"episodes": 0},
        {"language": "whispered"},
        {"split": "train", "perturb_start": True},
    ],
)
def test_orders_are_checked(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises((UnknownNameError, InvalidConfigError)):
        order(tmp_path, **wrong)


@pytest.mark.parametrize(
    ("policy", "problem"), [("reachnet", "No GPU"), ("oracle", "no model")]
)
def test_a_gpu_is_refused_where_it_is_no_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, policy: str, problem: str
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InvalidConfigError, match=problem):
        order(tmp_path, PolicySpec(policy, device="cuda"))
    with pytest.raises(InvalidConfigError, match="No GPU"):
        load_model("reachnet", "cuda")


def test_a_result_says_that_a_gpu_decided(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    monkeypatch.setattr(torch.backends.cudnn, "deterministic", False)
    here = order(tmp_path, "reachnet")
    there = order(tmp_path, PolicySpec("reachnet", device="cuda"))
    assert there.command() == f"{here.command()} --device cuda"
    # It is the same policy, but a run must not continue on another device.
    assert there.about() == here.about() | {"device": "cuda"}
    begin(tmp_path, ABOUT, here.about())
    (tmp_path / EPISODES).write_text("{}\n")
    with pytest.raises(DatasetError, match="device"):
        begin(tmp_path, ABOUT, there.about())
    model = load_model("reachnet")
    monkeypatch.setattr(specs, "load_model", loaded := Mock(return_value=model))
    assert load_policy(there.policy) is model
    loaded.assert_called_once_with("reachnet", "cuda")
    assert not torch.backends.cudnn.allow_tf32
    assert torch.backends.cudnn.deterministic


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
@pytest.mark.parametrize(
    "name", ["episodic-transformer+cliport", "m-cliport", "reachnet"]
)
def test_a_gpu_decides_as_a_cpu(tmp_path: Path, name: str) -> None:
    # First decisions are of the same images; later ones depend on bits of the poses.
    here, there = (
        evaluate(
            order(tmp_path / device, PolicySpec(name, device=device), tasks=SUITE),
            Serial(),
        )
        for device in ("cpu", "cuda")
    )
    for one, other in zip(here, there, strict=True):
        first, same = one["subtasks"][0], other["subtasks"][0]
        for part in ("robot", "primitive", "pick", "place"):
            assert first[part] == same[part]
        for end in ("pick", "place"):
            *xy, yaw = first["grounded"][end]
            *xy_too, yaw_too = same["grounded"][end]
            assert math.dist(xy, xy_too) < 1e-5
            assert abs(yaw - yaw_too) < 1e-4


# No success in n trials: up to z² / (n + z²).
@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (0, 60, 0.0, 0.06017),
        (30, 60, 0.37735, 0.62265),
        (60, 60, 0.93983, 1.0),
        (1, 10, 0.01788, 0.40415),
    ],
)
def test_wilson_interval(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=1e-5)


def test_the_verb_prints_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--tasks", "stack", "--instructions", "high-level, unseen")
    more = ("--episodes", 1, "--workers", 2, "--out", tmp_path)
    assert run("evaluate", "--policy", "oracle", *words, *more) == 0
    shown = capsys.readouterr().out
    assert "stack" in shown
    assert "unseen" in shown
    assert "100.0" in shown
    assert "mean, lenient" in shown


def test_the_command_of_a_result_can_be_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = str(tmp_path / "my task.py")
    monkeypatch.setattr(plugins, "_loaded", {plugin: object(), "their.tasks": object()})
    chat = ChatOptions(cassette=tmp_path / "my run.jsonl")
    policy = PolicySpec("llm:my model (v2)", timeout_s=7.0, chat=chat)
    asked = replace(order(tmp_path), policy=policy)
    command = asked.command()
    words = shlex.split(command)
    assert words[words.index("--policy") + 1] == "llm:my model (v2)"
    assert words[words.index("--timeout") + 1] == "7"
    assert words[words.index("--cassette") + 1] == "my run.jsonl"
    # Where a file lies differs by machine.
    assert [words[i + 1] for i, word in enumerate(words) if word == "--plugin"] == [
        "my task.py",
        "their.tasks",
    ]
    assert str(tmp_path) not in command
