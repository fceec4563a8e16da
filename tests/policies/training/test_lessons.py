"""Sentences for a reader alone."""

import numpy as np
import pytest

from lemma.policies.entities import BENCHMARK
from lemma.policies.text.lessons import Lesson, Lessons

LESSONS = Lessons(80, BENCHMARK, similar=6, orders=4)


def equal(one: Lesson, other: Lesson) -> bool:
    return np.array_equal(one.rows, other.rows) and one[1:] == other[1:]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_lesson_is_a_function_of_its_step_in_whatever_process(workers: int) -> None:
    steps = range(3, 8)
    ahead = list(LESSONS.ahead(steps, 5, 1, workers))
    here = [LESSONS.draw(5, step, 1) for step in reversed(steps)][::-1]
    assert all(map(equal, ahead, here))
    assert len(ahead) == len(steps)


def test_steps_seeds_and_processes_have_lessons_of_their_own() -> None:
    drawn = [LESSONS.draw(*key) for key in ((0, 1), (0, 2), (1, 1), (0, 1, 1))]
    assert not any(equal(drawn[0], other) for other in drawn[1:])
    assert all(len(lesson.rows) == len(lesson.goals) == 10 for lesson in drawn)
    assert all(lesson.reasons[6:] == [-1] * 4 for lesson in drawn)
    assert any(max(lesson.reasons) >= 0 for lesson in drawn)
