"""Scores of teams: counted as they are defined."""

from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from made_up import ABOUT, row, step
from rich.console import Console

from lemma.evaluation.analysis.result import read_result, summarise
from lemma.evaluation.analysis.team_scores import team_scores
from lemma.evaluation.protocol.schedules import executed_s
from lemma.evaluation.records import Row
from lemma.evaluation.report.policy_results import PolicyResults
from lemma.evaluation.report.sections import page
from lemma.evaluation.report.team_table import team_tables
from lemma.tasks.names import SUITES
from lemma.tasks.suite import load_instance


def work(robot: str, pick: str, start_s: float, end_s: float, **more: Any) -> Row:
    duration_s = end_s - start_s
    told = {"robot": robot, "pick": pick, "start_s": start_s, **more}
    return {**step(), **told, "place": "shared", "duration_s": duration_s}


def relay(**more: Any) -> Row:
    steps = [
        work("robot_0", "red_cube", 0.0, 10.0, effect_s=8.0, waited_s=1.0),
        work("robot_1", "red_cube", 9.0, 20.0, effect_s=None, waited_s=0.0),
    ]
    told = {"subtasks": steps, "idle_s": {"robot_0": 10.0, "robot_1": 9.0}}
    return {**row("relay", 0, success=True), **told, **more}


def test_time_is_shared_out_as_the_page_says() -> None:
    (found,) = team_scores([relay()])
    oracle_s = executed_s(load_instance("relay", "test", 0))
    assert oracle_s is not None
    assert (found.episodes, found.successes) == (1, 1)
    assert found.makespan_s == 20.0
    assert found.over_oracle == pytest.approx(20.0 / oracle_s)
    assert found.schedule_score == min(1.0, oracle_s / 20.0)
    assert found.concurrency == pytest.approx((9.0 + 11.0) / 20.0)
    # Until the cube lay there, and until somebody decided; of two robots' 40 s.
    idle = {"waiting": 1.0, "predecessor": 8.0, "thinking": 1.0, "no_work": 10.0}
    assert found.idle == pytest.approx({n: s / 40.0 for n, s in idle.items()})


def test_failures_have_no_makespan_and_score_nothing() -> None:
    (found,) = team_scores([relay(), relay(index=1, success=False)])
    assert (found.successes, found.makespan_s) == (1, 20.0)
    assert found.schedule_score is not None
    assert found.schedule_score <= 0.5
    (failed,) = team_scores([relay(success=False)])
    (row,) = team_tables([failed])["use of time"].rows
    assert row[:3] == ("relay", "0 of 1", "–")


def test_all_tasks_of_the_suite_fit_into_a_terminal() -> None:
    (one,) = team_scores([relay(success=False)])
    many = replace(one, episodes=200, successes=100, makespan_s=100.0, clearance_mm=1e3)
    scores = [replace(many, task=task) for task in SUITES["teams"]]
    for table in team_tables(scores).values():
        screen = StringIO()
        Console(width=80, file=screen).print(table.terminal())
        assert "…" not in screen.getvalue()
        assert all(task in screen.getvalue() for task in SUITES["teams"])


def test_turns_of_the_papers_suite_are_no_teams() -> None:
    assert team_scores([relay(task="stack2")]) == ()
    assert len(team_scores([relay(task="stack2", together={})])) == 1


def test_summaries_and_reports_have_the_table(tmp_path: Path) -> None:
    made = summarise([relay()], ABOUT)
    assert made.teams == team_scores([relay()])
    made.write(tmp_path / "summary.json")
    read = read_result(tmp_path / "summary.json")
    assert read == made
    shown = page([PolicyResults("Us", (read,))])
    for title, table in team_tables(made.teams).items():
        assert title in shown
        assert table.markdown() in shown
