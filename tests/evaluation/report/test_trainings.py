"""Requirements of what results tell of trainings."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from lemma.core.errors import DatasetError
from lemma.core.files import write_json
from lemma.evaluation.experiments.catalog import ABLATIONS, EXPERIMENTS
from lemma.evaluation.report.policy_results import NOTHING
from trainings import (
    Training,
    late_change,
    read_trainings,
    shares_of,
    training_of,
    training_table,
    undrawn,
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
    assert row[:6] == ("cliport", "a card", "1", "640", "12", "steps")
    assert row[-2:] == ("`grounded` 68.0", "+4.0")
    assert "cliport: grounded" in validation_figure([kept]).svg
    # Policies of LeRobot have no validation.
    unseen = {"model": "act", "history": [], "gpu_memory_gb": 0.0}
    write_json(tmp_path / "run" / "report.json", {**report, **unseen})
    (row,) = training_table([training_of(tmp_path / "run")]).rows
    assert row[-3:] == (NOTHING,) * 3
    (tmp_path / "kept" / "two.json").write_text('{"name": 3}')
    with pytest.raises(DatasetError, match="no training"):
        read_trainings(tmp_path / "kept")


def kept(curve: tuple[float, ...], shares: tuple[float, ...] = ()) -> Training:
    """Return the record of a training of CLIPort."""
    figures = (0, 640, 1.0, 5.0, 4.0, "a card", "time is up", "grounded")
    return Training("cliport", *figures, curve, "lemma train cliport", shares)


def test_the_late_change_begins_at_four_fifths_wherever_validations_were() -> None:
    rising = tuple(k / 10 for k in range(1, 11))
    assert late_change(kept(rising)) == pytest.approx(0.2)
    # A last validation just after the tenth one makes no difference.
    assert late_change(kept((*rising, 1.0))) == pytest.approx(0.2)
    for shares in ((0.3, 0.74, 1.0), (0.1, 0.8, 1.0), (0.5, 0.85, 0.95, 1.0)):
        assert late_change(kept(shares, shares)) == pytest.approx(0.2)
    assert training_table([kept(rising)]).rows[0][5] == "time"
    for unknown in (kept((0.1, 0.2, 0.3)), kept((0.5,), (1.0,))):
        assert late_change(unknown) is None
        assert training_table([unknown]).rows[0][-1] == NOTHING


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
    found = shares_of(training_of(tmp_path))
    assert found == (0.185, 0.37, 0.555, 0.74, 0.925, 1.0)


def test_the_figure_shows_all_seeds_but_ablations_and_names_what_it_lacks() -> None:
    every = read_trainings()
    picture = validation_figure(every).svg
    ablations = {
        one.policy.name for one in EXPERIMENTS.values() if one.suite == ABLATIONS
    }
    for one in every:
        drawn = f"<title>{one.name}, seed {one.seed}</title>" in picture
        told = f"`{one.name}` of seed {one.seed}" in undrawn(every)
        assert (drawn, told).count(True) == bool(
            one.curve and one.name not in ablations
        )
    known = [one for one in every if shares_of(one)]
    assert undrawn(known) == " Not drawn: ablations, and trainings without validation."
