"""The success of policies at control level, in tables of their own."""

from dataclasses import asdict
from pathlib import Path

import pytest
from made_up import result

from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from lemma.evaluation.experiments.catalog import CONTROL_TASKS, EXPERIMENTS
from lemma.evaluation.report import tables
from lemma.evaluation.report.policy_results import (
    CURVE,
    NOT_RUN,
    LearningCurve,
    Point,
    entries_of,
    read_curves,
)
from lemma.evaluation.report.sections import CONTROL, page, sections
from lemma.tasks.suite import SUITE

NAME = "act-privileged"
TITLE = EXPERIMENTS[NAME].title
CURVED = LearningCurve((Point(1000, 40, 1), Point(12_000, 40, 10)))


def test_they_stand_in_a_table_of_their_own_with_what_was_not_run() -> None:
    made = result(3, experiment=NAME, tasks=CONTROL_TASKS)
    entries = entries_of([result(5), made], complete=True)
    table = tables.control_level(entries)
    assert table.header == ("success [%]", "instructions", *CONTROL_TASKS, "mean")
    (row,) = [row for row in table.rows if row[0] == TITLE]
    assert row[1:3] == ("high-level", "30.0 (11–60)")
    (other,) = [row for row in table.rows if row[:2] == ("ACT, camera images", "blind")]
    assert other[-1] == NOT_RUN
    titles = {row[0] for row in tables.by_task(entries, "high_level").rows}
    assert "ReachNet" in titles
    assert TITLE not in titles


def test_a_result_of_all_their_tasks_is_no_sample() -> None:
    whole = result(3, experiment=NAME, tasks=CONTROL_TASKS, episodes=60)
    assert not any("ample" in one.caption for one in sections(entries_of([whole])))
    part = result(3, experiment=NAME, tasks=CONTROL_TASKS)
    assert any("A sample:**" in one.caption for one in sections(entries_of([part])))


def test_a_sample_is_of_their_own_tasks() -> None:
    part = result(3, experiment=NAME, tasks=CONTROL_TASKS)
    whole = result(5, tasks=SUITE, episodes=60)
    notes = {one.title: one.caption for one in sections(entries_of([whole, part]))}
    names = ", ".join(CONTROL_TASKS)
    words = f"10 of 60 episodes of each of 4 of the eight tasks ({names})"
    assert notes.pop(CONTROL).endswith(f"**A sample:** {words}.")
    assert not any("ample:**" in note for note in notes.values())


def test_learning_curves_are_read_back_and_shown(tmp_path: Path) -> None:
    (tmp_path / NAME).mkdir()
    write_json(tmp_path / NAME / CURVE, asdict(CURVED))
    curves = read_curves(tmp_path)
    assert curves == {NAME: CURVED}
    rows = tables.learning_curves(curves).rows
    assert rows == ((TITLE, "1,000", "40", "2.5"), (TITLE, "12,000", "40", "25.0"))
    assert f"| {TITLE} | 12,000 | 40 | 25.0 |" in page([], curves=curves)
    assert "Learning curves" not in page([])
    (tmp_path / NAME / CURVE).write_text('{"points": 3}')
    with pytest.raises(DatasetError, match="no learning curve"):
        read_curves(tmp_path)
