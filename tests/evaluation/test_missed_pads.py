"""Places of things that miss their pad."""

from typing import Any

import pytest

from lemma.tasks.suite import load_instance
from measure_missed_pads import COLUMNS, where

pytestmark = pytest.mark.render

INSTANCE = load_instance("pass", "test", 2)
AT = {o.color: o.pose for o in INSTANCE.scene.objects if o.kind == "pad"}


def episode(xy: tuple[float, float], error_mm: float | None) -> dict[str, Any]:
    place = {"place": [*xy, 0.0]}
    expert = {"place_error_mm": error_mm}
    subtask = {"place": "red_pad", "grounded": place, "expert": expert}
    nowhere = {"place": "shared", "grounded": place, "expert": expert}
    known = {"task": "pass", "split": "test", "index": 2}
    return {**known, "subtasks": [subtask, nowhere, {**subtask, "expert": None}]}


@pytest.mark.parametrize(
    ("xy", "error_mm", "columns"),
    [
        (AT["red"].xy, 3.0, COLUMNS[:1]),
        (AT["red"].xy, 30.0, (COLUMNS[0], "beside it")),
        (AT["pink"].xy, 1400.0, (COLUMNS[0], "another pad")),
        ((0.97, 0.25), 1400.0, (COLUMNS[0], "hidden table")),
        ((0.0, 1.0), 1400.0, (COLUMNS[0], "elsewhere")),
        ((0.0, 1.0), None, ()),
    ],
)
def test_a_missed_pad_is_counted_by_what_lies_there(
    xy: tuple[float, float], error_mm: float | None, columns: tuple[str, ...]
) -> None:
    assert tuple(where(episode(xy, error_mm))) == columns
