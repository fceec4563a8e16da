"""A hand that learned to place does it for a whole team, in turns."""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tiers import slow_but

import lemma
from lemma.policies.control.hand_steps import COLUMNS, HandPolicy
from lemma.policies.control.hand_team import HandTeam, HandTeamPolicy

OPTIONS: dict[str, Any] = HandPolicy.control_options
WEIGHTS = str(Path(__file__).parents[3] / "weights" / "hand_place.pt")


def still(x: torch.Tensor) -> torch.Tensor:
    """Return rows of hands that do not move."""
    return torch.zeros(len(x), len(COLUMNS))


@pytest.mark.parametrize(("task", "handed_on"), [("place", False), ("relay", True)])
def test_an_object_goes_to_where_the_next_robot_reaches(
    task: str, handed_on: bool
) -> None:
    with lemma.make(task, split="val", **OPTIONS) as env:
        seen, _ = env.reset(options={"index": 0})
    team = HandTeam(seen)
    team.step(seen, still)
    assert (team.spot is not None) is handed_on
    if team.spot is not None:
        # The end of a relay is two robots away; only the next one reaches the spot.
        margins = team.margins(team.spot)
        assert (margins > 0.0).sum() == 2
        assert margins[team.robot] > 0.0


def test_a_step_leaves_an_older_memory_as_it_was() -> None:
    with lemma.make("place", split="val", **OPTIONS) as env:
        seen, _ = env.reset(options={"index": 0})
    first = HandTeam(seen)
    first.step(seen, still)
    again = [copy(first) for _ in range(2)]
    for _ in range(3):
        again[0].step(seen, lambda x: still(x) + 1.0)
    expected = copy(first).step(seen, still)
    assert np.array_equal(again[1].step(seen, still), expected)


@pytest.mark.parametrize("task", slow_but(["stack", "pass2", "relay"]))
def test_placing_suffices_for_hand_overs_towers_and_relays(task: str) -> None:
    result = lemma.evaluate(
        HandTeamPolicy(WEIGHTS),
        level="control",
        tasks=(task,),
        split="val",
        episodes=2,
        workers=1,
    )
    assert any(row["success"] for row in result.rows)
