"""Summaries: complete, the same bytes for the same episodes, and readable again."""

from dataclasses import replace
from pathlib import Path

import pytest
from made_up import ABOUT, result, row, step

from lemma.core.errors import DatasetError
from lemma.evaluation.analysis.result import read_result, summarise
from lemma.evaluation.run.loading import learned_parts, training_seed, weights_of
from lemma.policies.spec import PolicySpec

ROWS = [
    row("stack", 0, success=True, steps=[step(2, pick_mm=2.0), step(1, place_mm=3.0)]),
    row("stack", 1, steps=[step(2, pick_mm=40.0, outcome="missed_grasp")], left=2),
    row("pass", 0, success=True, distractors=0, team="ur5+ur5"),
    row("pass", 0, instruction_kind="unseen", steps=[step(2, "robot")], left=2),
]


def test_everything_is_counted_once() -> None:
    made = summarise(ROWS, ABOUT)
    assert sum(cell.episodes for cell in made.cells) == len(ROWS)
    # In the order of kinds and tasks.
    assert [(c.kind, c.task, c.successes) for c in made.cells] == [
        ("high_level", "pass", 1),
        ("high_level", "stack", 1),
        ("unseen", "pass", 0),
    ]
    assert [(x.kind, x.task, x.cause, x.episodes) for x in made.losses] == [
        ("high_level", "stack", "missed_pick", 1),
        ("unseen", "pass", "wrong_robot", 1),
    ]
    pick, place = made.precisions
    assert (pick.end, pick.poses, pick.median_mm, pick.missed) == ("pick", 2, 21.0, 1)
    assert (place.end, place.poses, place.median_mm) == ("place", 1, 3.0)


def test_neither_order_nor_clock_shows_in_the_bytes(tmp_path: Path) -> None:
    slower = [{**one, "wall_s": 9.0} for one in reversed(ROWS)]
    summarise(ROWS, ABOUT).write(tmp_path / "a.json")
    summarise(slower, ABOUT).write(tmp_path / "b.json")
    first = (tmp_path / "a.json").read_bytes()
    assert first == (tmp_path / "b.json").read_bytes()
    summarise([{**ROWS[0], "elapsed_s": 9.0}, *ROWS[1:]], ABOUT).write(
        tmp_path / "c.json"
    )
    assert first != (tmp_path / "c.json").read_bytes()


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    made = result(3, seed=2)
    made.write(tmp_path / "seed-2.json")
    assert read_result(tmp_path / "seed-2.json") == made
    assert made.seed == 2


@pytest.mark.parametrize(
    ("old", "new"), [('"version": "1"', '"version": "0"'), ('"task"', '"tusk"')]
)
def test_other_files_are_named(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "summary.json"
    result(3).write(path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(DatasetError, match="summary"):
        read_result(path)


def test_a_policy_has_one_training_seed() -> None:
    weights = {"et": {"seed": 1}, "cliport": {"seed": 1}}
    assert training_seed(weights) == 1
    assert training_seed({}) == 0
    with pytest.raises(DatasetError, match="cliport: 2"):
        training_seed({**weights, "cliport": {"seed": 2}})


@pytest.mark.parametrize(
    ("policy", "parts"),
    [
        ("oracle", []),
        ("reachnet", ["reachnet"]),
        ("episodic-transformer+oracle", ["episodic-transformer"]),
        ("package.module:Class", []),
        ("http://127.0.0.1:8000", []),
        ("http://127.0.0.1:8000+cliport", ["cliport"]),
    ],
)
def test_only_our_own_weights_are_looked_at(policy: str, parts: list[str]) -> None:
    assert learned_parts(policy) == parts
    if not parts:
        assert weights_of(PolicySpec(policy)) == {}


def test_the_seed_is_told_by_the_weights() -> None:
    made = result(3)
    other = replace(made, about={**made.about, "weights": {"x": {"seed": 4}}})
    assert other.seed == 4
