"""Statistics of pictures by counting; `make test-lerobot` compares with lerobot's."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lemma.dataset.lerobot.shortcuts import counting, statistics_of_levels

QUANTILES = (0.01, 0.5, 0.99)


class Plain:
    """Stands for lerobot's own statistics."""

    def __init__(self) -> None:
        self.given: list[NDArray[np.float64]] = []

    def update(self, batch: NDArray[np.float64]) -> None:
        self.given.append(batch)

    def get_statistics(self) -> dict[str, int]:
        return {"batches": len(self.given)}


def pixels() -> NDArray[np.uint8]:
    rng = np.random.default_rng(0)
    spread = rng.normal((60, 120, 200), (5, 30, 60), (4, 500, 3))
    return spread.clip(0, 255).astype(np.uint8)


def test_statistics_are_those_of_the_pixels() -> None:
    running = counting(Plain, QUANTILES)()
    for picture in pixels():
        running.update(picture)
    found = running.get_statistics()
    every = pixels().reshape(-1, 3).astype(np.float64)
    assert found["count"].tolist() == [2000]
    for name, expected in (
        ("min", every.min(0)),
        ("max", every.max(0)),
        ("mean", every.mean(0)),
        ("std", every.std(0)),
        *((f"q{int(100 * q):02d}", np.quantile(every, q, axis=0)) for q in QUANTILES),
    ):
        tolerance = 1.0 if name.startswith("q") else 1e-9
        assert found[name] == pytest.approx(expected, abs=tolerance), name


def test_what_is_no_picture_goes_the_usual_way() -> None:
    running = counting(Plain, QUANTILES)()
    running.update(np.eye(14))
    running.update(np.arange(5, dtype=np.uint16)[:, None])
    running.update(np.zeros((5, 1)))
    assert running.get_statistics() == {"batches": 3}


def test_rows_that_are_all_the_same_are_their_own_statistics() -> None:
    row = np.array([0.25, -1.0], np.float32)
    running = counting(Plain, QUANTILES)()
    running.update(np.tile(row, (7, 1)))
    found = running.get_statistics()
    assert found.pop("count").tolist() == [7]
    assert found.pop("std").tolist() == [0.0, 0.0]
    assert set(found) == {"min", "max", "mean", "q01", "q50", "q99"}
    assert all(value.tolist() == row.tolist() for value in found.values())
    # Whatever comes later, nothing is forgotten.
    running.update(np.tile(row, (2, 1)))
    assert running.get_statistics() == {"batches": 2}
    assert [len(batch) for batch in running.given] == [7, 2]


def test_one_level_alone() -> None:
    counts = np.zeros((1, 256), np.int64)
    counts[0, 255] = 9
    found = statistics_of_levels(counts, QUANTILES)
    assert found["std"].tolist() == [0.0]
    assert {found[name].item() for name in ("min", "max", "mean", "q50")} == {255.0}
