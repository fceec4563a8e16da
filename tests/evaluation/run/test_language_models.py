"""Language models in evaluations: recorded once, the same bytes from then on."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from chat_server import RuleServer, chat_server
from command import run as command
from made_up import timeless

from lemma.core.errors import DatasetError
from lemma.core.workers.pool import ProcessPool, Serial
from lemma.evaluation.analysis.result import read_result, summarise
from lemma.evaluation.lines import read_rows
from lemma.evaluation.records import ABOUT, SUMMARY, Row, read_about
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.policies.planners.chat import ChatOptions, PlannerUnavailableError
from lemma.policies.spec import PolicySpec

TASKS = ("pass", "stack")


@pytest.fixture(autouse=True)
def no_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lemma.policies.planners.chat_client.WAITS_S", ())


def order(out: Path, chat: ChatOptions, **changes: Any) -> EvaluationConfig:
    # Two groups, so that two processes have work.
    wanted = {"tasks": TASKS, "episodes": 4, "split": "val", **changes}
    return EvaluationConfig(
        out=out, policy=PolicySpec("llm:rules", chat=chat), **wanted
    )


def lines(out: Path) -> list[dict[str, Any]]:
    return [dict(row) for row in timeless(read_rows(out))]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by a server that errs now and then, and its cassette."""
    out = tmp_path_factory.mktemp("recorded")
    # Four episodes ask at once, in any order: so far apart, no question gets two.
    well = ("",) * 8
    with chat_server("prose", *well, "name", *well, "list") as server:
        chat = ChatOptions(base_url=server.url, cassette=out / "c.jsonl")
        evaluate(order(out, chat), Serial())
    return out


@pytest.mark.slow
def test_counts_stand_in_lines_and_in_the_summary(recorded: Path) -> None:
    rows = lines(recorded)
    told = [row["planning"] for row in rows]
    assert sum(sum(each["invalid"].values()) for each in told) == 3
    assert all(each["calls"] >= each["decisions"] >= 3 for each in told)
    assert all(each["prompt_tokens"] > each["completion_tokens"] > 0 for each in told)
    result = summarise(rows, read_about(recorded))
    result.write(recorded / SUMMARY)
    assert read_result(recorded / SUMMARY) == result
    assert [each.task for each in result.planning] == list(TASKS)
    assert sum(each.episodes for each in result.planning) == 8
    assert sum(each.able for each in result.coordination) > 0
    about = json.loads((recorded / ABOUT).read_text())
    assert about["oracle"] is True
    assert about["planners"][0]["model"] == "rules"
    assert "127.0.0.1" not in json.dumps(about)


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "mode"), [(1, "strict"), (2, "replay")])
def test_replay_gives_the_same_bytes_without_a_server(
    tmp_path: Path, recorded: Path, workers: int, mode: Any
) -> None:
    cassette = recorded / "c.jsonl"
    before = cassette.read_bytes()
    config = order(tmp_path, ChatOptions(cassette=cassette, cassette_mode=mode))
    evaluate(config, ProcessPool(workers) if workers > 1 else Serial())
    assert lines(tmp_path) == lines(recorded)
    assert (tmp_path / ABOUT).read_bytes() == (recorded / ABOUT).read_bytes()
    assert cassette.read_bytes() == before


@pytest.mark.slow
def test_processes_record_what_one_does(tmp_path: Path) -> None:
    keys = []
    for workers in (1, 2):
        out = tmp_path / f"{workers}"
        with chat_server() as server:
            chat = ChatOptions(base_url=server.url, cassette=out / "c.jsonl")
            evaluate(order(out, chat), ProcessPool(workers))
        written = (out / "c.jsonl").read_text().splitlines()
        keys.append(sorted(written))
    assert keys[0] == keys[1]
    assert lines(tmp_path / "1") == lines(tmp_path / "2")


@pytest.mark.slow
def test_a_changed_prompt_is_a_clear_error_in_strict_mode(
    tmp_path: Path, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lemma.policies.planners import prompts  # noqa: PLC0415

    monkeypatch.setattr(prompts, "_TASK", prompts._TASK.replace("metres", "meters"))
    chat = ChatOptions(cassette=recorded / "c.jsonl", cassette_mode="strict")
    with pytest.raises(PlannerUnavailableError) as caught:
        evaluate(order(tmp_path, chat, episodes=1), Serial())
    told = str(caught.value)
    for words in (
        "strict mode",
        "metres",
        "meters",
        "in line ",
        "--cassette-mode record",
    ):
        assert words in told


@pytest.mark.slow
def test_another_setting_is_a_clear_error_too(tmp_path: Path, recorded: Path) -> None:
    chat = ChatOptions(
        cassette=recorded / "c.jsonl", cassette_mode="strict", max_tokens=7
    )
    with pytest.raises(PlannerUnavailableError, match=r"=1024' became 'max_tokens=7'"):
        evaluate(order(tmp_path, chat, episodes=1), Serial())
    # And no result goes on with answers to other questions.
    with pytest.raises(DatasetError):
        evaluate(order(recorded, replace(chat, cassette_mode="record")), Serial())


def test_a_cassette_that_cannot_be_used_ends_the_run(tmp_path: Path) -> None:
    with chat_server() as server:
        chat = ChatOptions(base_url=server.url, cassette=tmp_path)
        with pytest.raises(DatasetError, match="cassette"):
            evaluate(order(tmp_path / "out", chat, episodes=1), Serial())


def failures(rows: list[Row]) -> dict[str, int]:
    kinds = [row["policy_error"]["kind"] for row in rows if row["policy_error"]]
    return {kind: kinds.count(kind) for kind in kinds}


def play(tmp_path: Path, server: RuleServer, **options: Any) -> list[Row]:
    chat = ChatOptions(base_url=server.url, cassette=tmp_path / "c.jsonl", **options)
    spec = PolicySpec("llm:rules", chat=chat, timeout_s=0.7)
    config = EvaluationConfig(
        out=tmp_path / "out", policy=spec, tasks=("pass",), episodes=4, split="val"
    )
    return evaluate(config, Serial())


def test_the_run_goes_on_after_bad_answers(tmp_path: Path) -> None:
    with chat_server("500", "hang", "prose") as server:
        rows = play(tmp_path, server, tries=1)
    assert failures(rows) == {"raised": 1, "timeout": 1, "malformed": 1}
    failed = [row for row in rows if row["policy_error"]]
    assert {row["failure"] for row in failed} == {"policy_error"}
    assert all(row["planning"]["calls"] == 1 for row in failed)
    [good] = [row for row in rows if not row["policy_error"]]
    assert good["success"]
    # Requests that failed are on the cassette as well.
    chat = ChatOptions(cassette=tmp_path / "c.jsonl", cassette_mode="strict", tries=1)
    spec = PolicySpec("llm:rules", chat=chat, timeout_s=0.7)
    again = EvaluationConfig(
        out=tmp_path / "again", policy=spec, tasks=("pass",), episodes=4, split="val"
    )
    evaluate(again, Serial())
    assert lines(tmp_path / "again") == lines(tmp_path / "out")


@pytest.mark.slow
def test_a_server_that_goes_away_ends_the_run_and_what_is_done_stays(
    tmp_path: Path,
) -> None:
    with (
        chat_server("", "", "", "", always="401") as server,
        pytest.raises(PlannerUnavailableError, match="HTTP 401"),
    ):
        play(tmp_path, server)
    with chat_server() as server:
        assert len(play(tmp_path, server)) == 4
        # Four answers were there already.
        assert len(server.requests) == 12 - 4


def test_the_command_line_records_and_replays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cassette = tmp_path / "c.jsonl"
    line = ["evaluate", "--policy", "llm:rules", "--split", "val", "--tasks", "pass"]
    line += ["--episodes", "2", "--workers", "1", "--cassette", str(cassette)]

    def run(out: str, *more: str) -> tuple[object, str, str]:
        code = command(*line, "--out", tmp_path / out, *more)
        told = capsys.readouterr()
        return code, told.out, told.err

    with chat_server() as server:
        code, told, _ = run("a", "--base-url", server.url)
    assert code == 0
    assert "6 decisions, 6 calls" in told
    assert "0 invalid answers, 0 replans, 4 of 4" in told
    code, again, _ = run("b", "--cassette-mode", "strict")
    assert (code, again) == (0, told)
    summaries = [(tmp_path / out / SUMMARY).read_bytes() for out in "ab"]
    assert summaries[0] == summaries[1]
    code, _, error = run("c", "--cassette-mode", "strict", "--team", "each")
    assert code == 2
    assert "in line" in error
