"""Nothing but cameras tells who must act first."""

import pytest

from lemma.tasks.suite import SUITE
from measure_meta_information import (
    first_robot,
    instances,
    meta_information,
    share_right,
)

CHANCE, DEVIATION = 0.5, 0.5 / 800**0.5


@pytest.mark.slow
@pytest.mark.parametrize("task", SUITE)
def test_arms_bases_and_counts_do_not_tell_who_begins(task: str) -> None:
    found = instances(task)
    assert len(found) == 800
    told = [meta_information(instance) for instance in found]
    begins = [first_robot(instance) for instance in found]
    assert 0.4 < sum(begins) / len(begins) < 0.6
    assert share_right(told, begins) < CHANCE + 3.0 * DEVIATION


@pytest.mark.slow
def test_it_would_be_found_if_a_base_told() -> None:
    found = instances("poke", ("test",))
    told = [meta_information(instance) for instance in found]
    hints = [row[2] > sorted(row[2] for row in told)[30] for row in told]
    assert share_right(told, [int(hint) for hint in hints]) > 0.8
