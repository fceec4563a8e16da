"""A policy that learned on a GPU plays on the CPU."""

from pathlib import Path

import lemma
from lemma.policies.control.hand_steps import HandPolicy

WEIGHTS = Path(__file__).parents[3] / "weights" / "hand_reach.pt"


def test_the_shipped_hand_reaches_in_every_degree() -> None:
    result = lemma.evaluate(
        HandPolicy(str(WEIGHTS)),
        level="control",
        tasks=("reach_fixed", "reach_varied", "reach"),
        episodes=1,
        workers=1,
    )
    assert [row["success"] for row in result.rows] == [True] * 3
