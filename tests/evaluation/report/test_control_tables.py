"""Tables of policies at control level, and their learning curves."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest
from made_up import result

import gpu_curves
from learning_curves import (
    CURVE,
    LearningCurve,
    Point,
    learning_curves,
    read_curves,
)
from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from lemma.evaluation.experiments.catalog import EXPERIMENTS
from lemma.evaluation.report import tables
from lemma.evaluation.report.policy_results import (
    NOT_RUN,
    NOTHING,
    PARTIAL,
    entries_of,
)
from lemma.evaluation.report.rung_table import command_table, rung_table
from lemma.evaluation.report.sections import HOW, RUNGS, protocol_words, sections
from lemma.tasks.suite import SUITE

NAME = "act-reach"
TITLE, TASKS = EXPERIMENTS[NAME].title, EXPERIMENTS[NAME].tasks
CURVED = LearningCurve((Point(1000, 40, 1), Point(12_000, 40, 10)))


def test_they_stand_in_a_table_of_their_own_with_what_was_not_run() -> None:
    made = result(3, experiment=NAME, tasks=TASKS)
    entries = entries_of([result(5), made], complete=True)
    table = tables.control_level(entries)
    assert {*TASKS, *EXPERIMENTS["keypose"].tasks} < {*table.header}
    (row,) = [row for row in table.rows if row[0] == TITLE]
    found = dict(zip(table.header, row, strict=True))
    assert found["instructions"] == "high-level"
    assert all(found[task] == "30.0 (11–60)" for task in TASKS)
    (other,) = [row for row in table.rows if row[0] == EXPERIMENTS["act-lift"].title]
    assert other[-1] == NOT_RUN
    titles = {row[0] for row in tables.by_task(entries, "high_level").rows}
    assert "ReachNet" in titles
    assert TITLE not in titles


def test_their_stages_are_told_task_by_task_and_mixed_with_no_others() -> None:
    made = result(3, experiment=NAME, tasks=TASKS)
    entries = entries_of([result(5, tasks=SUITE), made], complete=True)
    found = {one.title: one.table for one in sections(entries)}
    rows = found[RUNGS].rows
    assert [row[:2] for row in rows] == [(TITLE, task) for task in TASKS]
    for name in ("Stages", "Coordination", "Where the points are lost"):
        titles = {row[0] for row in found[name].rows}
        assert "ReachNet" in titles
        assert TITLE not in titles
    assert PARTIAL not in protocol_words(entries)


def test_kinds_of_instructions_are_counted_apart_and_stages_are_of_one() -> None:
    tasks = EXPERIMENTS["keypose"].tasks
    said, unseen = (
        result(wins, experiment="keypose", tasks=tasks, kind=kind)
        for wins, kind in ((8, "high_level"), (2, "unseen"))
    )
    both = replace(
        said,
        cells=said.cells + unseen.cells,
        reached=said.reached + unseen.reached,
    )
    alone, mixed = (entries_of([one], complete=True) for one in (said, both))
    found = {
        row[1]: row for row in tables.control_level(mixed).rows if row[0] == "KeyPose"
    }
    assert found["high-level"][2:4] != found["unseen"][2:4]
    assert found["high-level"][-1] == found["unseen"][-1] == str(10 * len(tasks))
    assert found["human"][-1] == NOT_RUN
    rows = [{one.title: one.table for one in sections(each)} for each in (alone, mixed)]
    assert rows[0][RUNGS].rows == rows[1][RUNGS].rows


def test_policies_of_one_rung_each_share_a_row() -> None:
    rungs = ("act-reach", "act-lift")
    found = [
        result(wins, experiment=name, tasks=EXPERIMENTS[name].tasks)
        for name, wins in zip(rungs, (3, 6), strict=True)
    ]
    entries = entries_of([*found, result(5)], complete=True)
    ((title, *rates),) = rung_table(entries).rows
    assert title == "ACT"
    assert rates == ["30.0 (11–60)"] * 3 + ["60.0 (31–83)"] * 3
    assert rung_table(entries_of([result(5)], complete=True)).rows == ()
    # Each has its own command, and a time where there is a record.
    found.append(result(2, experiment="keypose", tasks=EXPERIMENTS["keypose"].tasks))
    times = {"keypose": "12, 13", "act-reach": "500"}
    rows = command_table(entries_of(found), times).rows
    titles = [EXPERIMENTS[name].title for name in (*rungs, "keypose")]
    assert sorted((row[0], row[-1]) for row in rows) == sorted(
        zip(titles, ("500", NOTHING, "12, 13"), strict=True)
    )
    lift = EXPERIMENTS["act-lift"]
    training = lift.training.replace("{seed}", "SEED")
    assert any(row[0] == lift.title and training in row[2] for row in rows)


def test_weights_of_a_training_that_a_time_ended_are_marked() -> None:
    limited = result(3, experiment="keypose", tasks=EXPERIMENTS["keypose"].tasks)
    weights = {"keypose": {"sha256": "f" * 64, "seed": 0, "ended": "time limit"}}
    limited = replace(limited, about={**limited.about, "weights": weights})
    made = [limited, result(5)]
    rows = {one.title: one.table for one in sections(entries_of(made))}[HOW].rows
    marked = {row[0]: "nobody can repeat it" in row[2] for row in rows}
    assert marked == {"KeyPose": True, "ReachNet": False}


def test_a_result_of_all_their_tasks_is_no_sample() -> None:
    whole = result(3, experiment=NAME, tasks=TASKS, episodes=60)
    assert not any("ample" in one.caption for one in sections(entries_of([whole])))
    part = result(3, experiment=NAME, tasks=TASKS)
    assert any("A sample:**" in one.caption for one in sections(entries_of([part])))


def test_learning_curves_are_read_back_and_shown(tmp_path: Path) -> None:
    (tmp_path / NAME).mkdir()
    write_json(tmp_path / NAME / CURVE, asdict(CURVED))
    curves = read_curves(tmp_path)
    assert curves == {NAME: CURVED}
    rows = learning_curves(curves).rows
    assert rows == ((TITLE, "1,000", "40", "2.5"), (TITLE, "12,000", "40", "25.0"))
    (tmp_path / NAME / CURVE).write_text('{"points": 3}')
    with pytest.raises(DatasetError, match="no learning curve"):
        read_curves(tmp_path)


def test_curves_of_the_gpu_have_a_point_for_each_million_steps() -> None:
    lines = (
        "98304 steps, 0 s: 27% of 482 succeeded, potential 0.27\n"
        "1081344 steps, 23 s: 45% of 2466 succeeded, potential 0.29\n"
        "49,548 steps/s with learning; hand.pt\n"
    )
    found = gpu_curves.curve(lines)
    assert {million: mark.value for million, mark in found.items()} == {
        0: 0.27,
        1: 0.45,
    }
    # Fonts of a figure differ by machine.
    assert gpu_curves.FIGURE.is_file()
    assert all(
        path.stem.split("-")[0] in gpu_curves.figure()
        for path in gpu_curves.LOGS.glob("*.txt")
    )
