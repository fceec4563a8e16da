"""Requirements of what results tell of trainings."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from lemma.evaluation.experiments.catalog import ABLATIONS, EXPERIMENTS
from trainings import (
    marks_of,
    read_trainings,
    training_of,
    training_table,
    validation_figure,
)


def test_trainings_are_kept_listed_and_plotted(tmp_path: Path) -> None:
    scores = [0.5 + k / 50 for k in range(10)]
    report = {
        **{"model": "cliport", "samples": 640, "seconds": 12.34, "samples_per_s": 55.5},
        **{"gpu_memory_gb": 44.0, "device": "a card", "status": "finished"},
        "steps": 10,
        "command": "lemma train cliport --out runs/seed-1/cliport --seed 1",
        "history": [{"step": k, "grounded": one} for k, one in enumerate(scores, 1)],
        "scores": {},
    }
    write_json(tmp_path / "run" / "report.json", report)
    kept = replace(training_of(tmp_path / "run"), name="cliport")
    write_json(tmp_path / "kept" / "one.json", asdict(kept))
    assert read_trainings(tmp_path / "kept") == [kept]
    (row,) = training_table([kept]).rows
    assert row[:5] == ("cliport", "a card", "1", "640", "12")
    assert row[-2:] == ("`grounded` 68.0", "+4.0")
    assert "cliport: grounded" in validation_figure([kept]).svg
    (tmp_path / "kept" / "two.json").write_text('{"name": 3}')
    with pytest.raises(DatasetError, match="no training"):
        read_trainings(tmp_path / "kept")


def test_a_training_that_was_cut_short_has_its_scores_where_they_were_taken(
    tmp_path: Path,
) -> None:
    report = {
        **{"model": "keypose", "samples": 640, "seconds": 1.0, "samples_per_s": 5.0},
        **{"gpu_memory_gb": 4.0, "device": "a card", "status": "time is up"},
        **{"steps": 3380, "command": "lemma train keypose --seed 1", "scores": {}},
        "history": [
            {"step": 625 * k, "decided": k / 10} for k in (1, 2, 3, 4, 5, 5.408)
        ],
    }
    write_json(tmp_path / "report.json", report)
    marks = marks_of(training_of(tmp_path))
    found = {k: mark.value for k, mark in enumerate(marks, 1) if mark}
    assert found == {2: 0.1, 4: 0.2, 6: 0.3, 7: 0.4, 9: 0.5, 10: 0.5408}


def test_the_figure_shows_all_trainings_but_ablations() -> None:
    kept = read_trainings()
    picture = validation_figure(kept).svg
    every = EXPERIMENTS.values()
    ablations = {one.policy.name for one in every if one.suite == ABLATIONS}
    missing = {one.name for one in kept if f"{one.name}: " not in picture}
    assert missing == {one.name for one in kept} & ablations
