"""The allocation solver agrees with trying everything."""

import math
from itertools import product

import numpy as np
import pytest
from allocation import allocate
from hypothesis import given, settings
from hypothesis import strategies as st

from lemma.core.errors import InvalidConfigError
from lemma.core.poses import FloatArray

Problem = tuple[FloatArray, FloatArray, float]


@st.composite
def problems(draw: st.DrawFn) -> Problem:
    robots = draw(st.integers(1, 3))
    subtasks = draw(st.integers(1, 5))
    worth = st.one_of(st.just(-math.inf), st.integers(-40, 10).map(lambda v: v / 8))
    seconds = st.integers(1, 80).map(lambda v: v / 4)

    def table(entry: st.SearchStrategy[float]) -> FloatArray:
        row = st.lists(entry, min_size=subtasks, max_size=subtasks)
        return np.array(draw(st.lists(row, min_size=robots, max_size=robots)))

    # Not a multiple of a quarter of a second: never exactly on the limit.
    limit = draw(st.integers(1, 100)) + 0.1
    return table(worth), table(seconds), limit


def by_trying(utilities: FloatArray, durations: FloatArray, limit: float) -> float:
    robots, subtasks = utilities.shape
    best = -math.inf
    for choice in product(range(robots), repeat=subtasks):
        total = sum(durations[robot, m] for m, robot in enumerate(choice))
        worth = sum(utilities[robot, m] for m, robot in enumerate(choice))
        if total <= limit:
            best = max(best, worth)
    return best


@settings(max_examples=30)
@given(problems())
def test_allocation_is_the_best_of_all(problem: Problem) -> None:
    utilities, durations, limit = problem
    best = by_trying(*problem)
    chosen = allocate(*problem)
    if best == -math.inf:
        assert chosen is None
        return
    assert chosen is not None
    assert len(chosen) == utilities.shape[1]
    worth = sum(utilities[robot, m] for m, robot in enumerate(chosen))
    total = sum(durations[robot, m] for m, robot in enumerate(chosen))
    assert worth == pytest.approx(best)
    assert total <= limit + 1e-6


def test_a_robot_that_cannot_is_never_chosen() -> None:
    utilities = np.array([[-math.inf, -9.0], [-9.0, -math.inf]])
    assert allocate(utilities, np.ones((2, 2)), 100.0) == (1, 0)


def test_a_sub_task_that_nobody_can_do_has_no_allocation() -> None:
    utilities = np.array([[-1.0, -math.inf], [-1.0, -math.inf]])
    assert allocate(utilities, np.ones((2, 2)), 100.0) is None


def test_time_makes_the_second_best_the_best() -> None:
    utilities = np.array([[-1.0, -1.0], [-2.0, -2.0]])
    durations = np.array([[9.0, 9.0], [1.0, 1.0]])
    assert allocate(utilities, durations, 18.0) == (0, 0)
    assert allocate(utilities, durations, 2.0) == (1, 1)
    assert sorted(allocate(utilities, durations, 10.0) or ()) == [0, 1]
    assert allocate(utilities, durations, 1.9) is None


def test_one_robot_may_do_it_all_and_there_may_be_three() -> None:
    utilities = np.array([[-3.0] * 4, [-1.0] * 4, [-2.0] * 4])
    assert allocate(utilities, np.ones((3, 4)), 100.0) == (1, 1, 1, 1)


def test_nothing_to_do_is_done() -> None:
    assert allocate(np.zeros((2, 0)), np.zeros((2, 0)), 100.0) == ()


@pytest.mark.parametrize(
    ("utilities", "durations"),
    [
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.zeros(3), np.zeros(3)),
        (np.zeros((2, 3, 1)), np.zeros((2, 3, 1))),
    ],
)
def test_tables_of_another_shape_are_refused(
    utilities: FloatArray, durations: FloatArray
) -> None:
    with pytest.raises(InvalidConfigError, match="robots, sub-tasks"):
        allocate(utilities, durations, 100.0)
