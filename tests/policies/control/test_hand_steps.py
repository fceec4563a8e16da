"""Hands that learned by reward play on the CPU."""

from pathlib import Path

import pytest
from tiers import slow_but

import lemma
from lemma.policies.control.hand_steps import HandPolicy

WEIGHTS = Path(__file__).parents[3] / "weights"


@pytest.mark.parametrize(
    ("name", "tasks"),
    [
        ("hand_reach.pt", ("reach_fixed", "reach_varied", "reach")),
        *slow_but(
            [
                ("hand_lift.pt", ("lift_fixed", "lift_varied", "lift")),
                ("hand_place.pt", ("place_fixed", "place_varied", "place")),
            ]
        ),
    ],
)
def test_shipped_hands_do_in_every_degree_what_they_learned(
    name: str, tasks: tuple[str, ...]
) -> None:
    result = lemma.evaluate(
        HandPolicy(str(WEIGHTS / name)),
        level="control",
        tasks=tasks,
        episodes=2,
        workers=1,
    )
    assert sum(row["success"] for row in result.rows) >= 5
