"""The numbers of a recipe."""

from dataclasses import replace
from pathlib import Path

import pytest
from recipes import made_up, small_recipe, write_recipe

from lemma.dataset.recipe.files import load
from lemma.dataset.recipe.summary import Spread, summarize


def test_numbers_are_those_of_the_episodes() -> None:
    recipe = load(small_recipe())
    found, records = summarize(recipe), list(recipe)
    assert found.total.episodes == found.total.solved == len(records)
    assert list(found.tasks) == ["pass", "stack"]
    assert list(found.splits) == ["val", "test"]
    elapsed = [record.elapsed_s for record in records]
    assert found.total.elapsed_s == Spread.of(elapsed)
    assert found.total.elapsed_s.least == min(elapsed)
    assert found.total.subtasks.mean == pytest.approx(
        sum(len(record.subtasks) for record in records) / len(records)
    )
    assert sum(found.total.teams.values()) == len(records)
    assert sum(group.episodes for group in found.teams.values()) == len(records)
    moves = [row.duration_s for record in records for row in record.subtasks]
    assert found.primitives_s["move"] == Spread.of(moves)
    # The sampler keeps goals inside of the reach.
    assert found.total.margin_m.least > 0.0
    assert 0.0 < found.total.idle_share < 1.0


def test_a_team_that_is_none_of_the_benchmarks(tmp_path: Path) -> None:
    team = "ur5+ur5+ur5"
    write_recipe(tmp_path, [replace(made_up(), team=team)])
    found = summarize(load(tmp_path))
    assert found.total.teams == {team: 1}
    assert found.teams[team].episodes == 1
