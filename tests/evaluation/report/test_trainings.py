"""Requirements of what results tell of trainings."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from trainings import (
    TENTHS,
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
        "command": "lemma train cliport --out runs/seed-1/cliport --seed 1",
        "history": [{"step": k, "grounded": one} for k, one in enumerate(scores)],
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


def test_the_figure_shows_a_training_of_every_model_that_was_not_cut_short() -> None:
    kept = read_trainings()
    picture = validation_figure(kept).svg
    missing = {one.name for one in kept if f"{one.name}: " not in picture}
    whole = {one.name for one in kept if len(one.curve) >= TENTHS}
    assert missing == {one.name for one in kept} - whole
