"""Numbers of a recipe, checked by hand; and the balance of the frozen lists."""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow.parquet import ParquetFile
from recipes import made_up, small_recipe, write_recipe
from scipy.stats import chisquare

from lemma.core.errors import DatasetError
from lemma.dataset.recipe.balance import (
    ALL,
    DRAWS,
    TEAM_NAMES,
    balance,
    balances_of,
    draws_of,
    evenness,
    uniform_p_value,
)
from lemma.dataset.recipe.reader import load
from lemma.dataset.recipe.schema import SCHEMA, EpisodeRecord
from lemma.dataset.recipe.statistics import (
    Spread,
    Statistics,
    facts_of,
    rejections,
    statistics_of,
)
from lemma.robots.reach import reach_of
from lemma.scene.palette import OBJECT_COLORS
from lemma.tasks.instance import SPLITS
from lemma.tasks.suite import SUITE, load_instance


def by_hand(
    task: str,
    split: str,
    index: int,
    arms: tuple[str, str],
    distractors: int,
    durations_s: Sequence[float],
    success: bool = True,
) -> EpisodeRecord:
    """Return an episode of which all numbers are known."""
    record = made_up(task, split, index)
    data = record.instance_data()
    # The first robot half a metre left of the middle, the second a metre right of it.
    data["robots"] = [
        [arms[0], "red", -0.5, 0.0, 0.0],
        [arms[1], "white", 1.0, 0.0, 3.0],
    ]
    data["goal"] = [["pink_cube", "blue_pad"]]
    data["objects"] = data["objects"][:1] * (2 + distractors)
    row = record.subtasks[0]
    subtasks = tuple(
        replace(
            row,
            robot=f"robot_{i % 2}",
            primitive="hook" if i == 1 else "move",
            pick_pose=(0.0, 0.0, 0.0),
            place_pose=(0.1, 0.0, 0.0),
            duration_s=duration_s,
        )
        for i, duration_s in enumerate(durations_s)
    )
    elapsed_s = sum(durations_s)
    return replace(
        record,
        team="+".join(sorted(arms, key=("ur5", "ur10").index)),
        distractors=distractors,
        instance=json.dumps(data),
        subtasks=subtasks,
        success=success,
        failure=None if success else "timeout",
        elapsed_s=elapsed_s,
        idle_s=(elapsed_s / 4, elapsed_s / 2),
    )


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """Two episodes of stack for training, one of hook for validation."""
    write_recipe(tmp_path, [by_hand("hook", "val", 0, ("ur10", "ur10"), 3, [7.0, 9.0])])
    first = by_hand("stack", "train", 0, ("ur5", "ur10"), 0, [4.0])
    second = by_hand("stack", "train", 1, ("ur10", "ur5"), 1, [5.0, 6.0, 7.0], False)
    write_recipe(tmp_path, [first, second])
    return tmp_path


def found_in(folder: Path) -> Statistics:
    return statistics_of(load(folder))


def test_episodes_are_counted_by_task_split_and_team(recipe: Path) -> None:
    found = found_in(recipe)
    assert found.total.episodes == 3
    assert {name: group.episodes for name, group in found.tasks.items()} == {
        "stack": 2,
        "hook": 1,
    }
    assert {name: group.episodes for name, group in found.splits.items()} == {
        "train": 2,
        "val": 1,
    }
    assert {name: group.episodes for name, group in found.teams.items()} == {
        "ur5+ur10": 2,
        "ur10+ur10": 1,
    }
    assert {name: group.episodes for name, group in found.cells.items()} == {
        "stack/train/ur5+ur10": 2,
        "hook/val/ur10+ur10": 1,
    }
    assert found.total.teams == {"ur5+ur5": 0, "ur5+ur10": 2, "ur10+ur10": 1}
    # In the order of the paper's tables, not of the files.
    assert list(found.tasks) == ["stack", "hook"]
    assert list(found.splits) == ["train", "val"]


def test_numbers_of_groups(recipe: Path) -> None:
    found = found_in(recipe)
    stack, hook = found.tasks["stack"], found.tasks["hook"]
    assert stack.solved == 1
    assert hook.solved == 1
    assert stack.subtasks == Spread(1.0, 2.0, 3.0)
    assert stack.objects == Spread(2.0, 2.5, 3.0)
    assert stack.distractors == Spread(0.0, 0.5, 1.0)
    assert stack.elapsed_s == Spread(4.0, 11.0, 18.0)
    assert hook.elapsed_s == Spread(16.0, 16.0, 16.0)
    assert found.total.elapsed_s == Spread(4.0, (4.0 + 18.0 + 16.0) / 3, 18.0)
    # One robot waits for a quarter, the other for half of every episode.
    assert found.total.idle_share == pytest.approx(0.375)
    assert found.cells["stack/train/ur5+ur10"] == stack


def test_durations_of_primitives(recipe: Path) -> None:
    found = found_in(recipe).primitives_s
    assert list(found) == ["move", "hook"]
    assert found["move"] == Spread(4.0, (7.0 + 4.0 + 5.0 + 7.0) / 4, 7.0)
    assert found["hook"] == Spread(6.0, 7.5, 9.0)


def test_margins_are_to_the_reach_of_the_robot_that_acts(recipe: Path) -> None:
    first = next(fact for fact in facts_of(load(recipe)) if fact.task == "stack")
    ur5 = reach_of("ur5")
    # The UR5 stands at x = -0.5; it picks at 0 and places at 0.1.
    for margin_m, distance_m in zip(first.margins_m, (0.5, 0.6), strict=True):
        expected = min(ur5.travel_m - distance_m, distance_m - ur5.inner_m)
        assert margin_m == pytest.approx(expected)
    second = next(fact for fact in facts_of(load(recipe)) if len(fact.durations_s) == 3)
    # There the second sub-task is the UR5's at x = 1: one metre is out of its reach.
    assert second.margins_m[2] == pytest.approx(ur5.travel_m - 1.0)
    assert second.margins_m[2] < 0.0
    least = min(m for fact in facts_of(load(recipe)) for m in fact.margins_m)
    assert found_in(recipe).total.margin_m.least == least


def test_draws_of_an_episode(recipe: Path) -> None:
    first = next(fact for fact in facts_of(load(recipe)) if fact.task == "hook")
    assert first.draws == {
        "cube of the goal": "pink",
        "pad below it": "blue",
        "left robot": "red",
        "right robot": "white",
        "team": "ur10+ur10",
    }


def test_rejections_are_those_of_the_splits_at_hand(recipe: Path) -> None:
    found = found_in(recipe).rejections["hook"]
    assert found == rejections("hook", ["val"])
    assert found.instances == SPLITS["val"]
    every = rejections("hook", SPLITS)
    assert every.instances == sum(SPLITS.values())
    tables = every.instances + every.by_sampler + every.by_expert
    assert every.sampler_rate == every.by_sampler / tables
    assert 0.0 < every.sampler_rate < 0.5
    assert every.expert_rate == every.by_expert / (every.instances + every.by_expert)
    assert rejections("pass", ["val"]).sampler_rate == 0.0


def test_json_has_everything_and_no_objects(recipe: Path) -> None:
    data = found_in(recipe).to_dict()
    assert json.loads(json.dumps(data)) == data
    assert data["tasks"]["stack"]["elapsed_s"]["most"] == 18.0
    assert data["cells"]["hook/val/ur10+ur10"]["episodes"] == 1
    assert data["rejections"]["hook"]["sampler_rate"] == pytest.approx(7 / 47)
    assert data["evenness"]["even"] is True
    assert data["balances"]["team"][ALL]["p_value"] is None
    assert "facts" not in data


def test_a_part_of_a_recipe(recipe: Path) -> None:
    found = statistics_of(load(recipe).select(task="hook"))
    assert found.total == found.tasks["hook"]
    assert list(found.rejections) == ["hook"]


def test_a_real_recipe_agrees_with_its_episodes() -> None:
    recipe = load(small_recipe())
    found = statistics_of(recipe)
    assert found.total.episodes == found.total.solved == len(recipe) == 12
    seconds = [record.elapsed_s for record in recipe]
    assert found.total.elapsed_s.mean == pytest.approx(sum(seconds) / 12)
    # The expert of these tasks grasps nothing at the edge.
    assert found.total.margin_m.least > 0.02


def test_a_damaged_recipe_is_named(recipe: Path) -> None:
    path = recipe / "val" / "hook.parquet"
    group = ParquetFile(path).metadata.row_group(0)
    instances = group.column(SCHEMA.names.index("instance"))
    data = bytearray(path.read_bytes())
    # Within the values; what follows them is a page header that says them again.
    data[(instances.dictionary_page_offset + instances.data_page_offset) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match=r"hook\.parquet is damaged"):
        found_in(recipe)


# Balance.


@given(st.lists(st.integers(0, 1000), min_size=2, max_size=6).filter(any))
def test_p_value_is_that_of_scipy(counts: list[int]) -> None:
    assert uniform_p_value(counts) == pytest.approx(chisquare(counts).pvalue, rel=1e-9)


def test_p_values_from_a_table() -> None:
    # The 5% point of chi-square with four degrees of freedom is 9.488.
    assert uniform_p_value([20, 20, 20, 20, 20]) == 1.0
    spread = (9.488 / 2 * 20) ** 0.5
    counts: list[Any] = [20 - spread, 20 + spread, 20, 20, 20]
    assert uniform_p_value(counts) == pytest.approx(0.05, abs=1e-4)


def colors(counts: Sequence[int]) -> list[dict[str, str]]:
    """Return as many draws of every color."""
    return [
        {"cube of the goal": color}
        for color, count in zip(OBJECT_COLORS, counts, strict=True)
        for _ in range(count)
    ]


def test_too_few_are_not_tested() -> None:
    few = balance("cube of the goal", colors([24, 0, 0, 0, 0]))
    assert few is not None
    assert few.p_value is None
    assert few.counts == {"pink": 24, "red": 0, "white": 0, "blue": 0, "green": 0}
    enough = balance("cube of the goal", colors([25, 0, 0, 0, 0]))
    assert enough is not None
    assert enough.p_value is not None
    assert enough.p_value < 1e-9
    assert balance("pad below it", colors([5, 5, 5, 5, 5])) is None
    nothing = evenness({})
    assert nothing.even
    assert nothing.smallest_p is None


def test_one_of_many_tests_may_be_unlikely() -> None:
    even = {task: colors([20, 20, 20, 20, 20]) for task in SUITE}
    # p is 0.02: less than one in twenty, but there are nine tests.
    unlucky = balances_of(even | {"pass": colors([14, 20, 20, 33, 13])})
    p_value = unlucky["cube of the goal"]["pass"].p_value
    assert p_value is not None
    assert 0.01 < p_value < 0.03
    found = evenness(unlucky)
    assert found.tests == 9
    assert found.smallest_p == p_value
    assert found.even
    assert not evenness(balances_of(even | {"pass": colors([5, 20, 20, 40, 15])})).even


def frozen_draws() -> dict[str, list[dict[str, str]]]:
    """Return what all 6,400 instances drew, by task."""
    return {
        task: [
            draws_of(load_instance(task, split, index).to_dict())
            for split, count in SPLITS.items()
            for index in range(count)
        ]
        for task in SUITE
    }


def test_the_frozen_lists_are_balanced() -> None:
    draws = frozen_draws()
    assert sum(map(len, draws.values())) == 6400
    balances = balances_of(draws)
    assert set(balances) == set(DRAWS)
    # Every task is tested for its cube, what is below it, both robots and the team.
    assert set(balances["team"]) == {ALL, *SUITE}
    assert set(balances["pad below it"]) | set(balances["cube below it"]) == {
        ALL,
        *SUITE,
    }
    found = evenness(balances)
    assert found.tests == 6 * 1 + 5 * len(SUITE)
    assert found.even, found
    for name in DRAWS:
        assert all(balances[name][ALL].counts.values())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cube of the goal", "red"),
        ("cube below it", "green"),
        ("left robot", "white"),
        ("team", TEAM_NAMES[0]),
    ],
)
def test_a_bias_in_one_task_is_found(name: str, value: str) -> None:
    draws = frozen_draws()
    drawn = draws["stack"]
    # Every eighth instance draws what the biased sampler prefers.
    draws["stack"] = [
        {**draw, name: value} if biased else draw
        for draw, biased in zip(drawn, islice(cycle([1] + [0] * 7), 800), strict=True)
    ]
    balances = balances_of(draws)
    found = evenness(balances)
    assert not found.even
    assert found.smallest_p == balances[name]["stack"].p_value
