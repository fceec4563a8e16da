"""One network moves both hands of a team, whatever the order of the robots."""

from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tiers import slow_but

import lemma
from lemma.policies.control.hand_steps import COLUMNS
from lemma.policies.control.team_rules import TeamRules, demonstrate
from lemma.policies.control.team_steps import (
    TEAM_FEATURES,
    Team,
    TeamHands,
    TeamPolicy,
    team_network,
)

OPTIONS: dict[str, Any] = TeamPolicy.control_options


def begun(task: str) -> tuple[Any, TeamHands]:
    """Return the first observation of an episode, and the hands of its team."""
    with lemma.make(task, split="val", **OPTIONS) as env:
        seen, _ = env.reset(options={"index": 0})
    return seen, TeamHands(seen)


def swapped(team: Team) -> Team:
    """Return a team with its robots in the other order."""
    names = ("goal", "target", "here", "base", "asked", "homes")
    arms = type(team.arms)(*(part.flip(0) for part in team.arms.parts))
    return replace(team, arms=arms, **{n: getattr(team, n).flip(0) for n in names})


def test_the_order_of_the_robots_makes_no_difference() -> None:
    seen, hands = begun("pass")
    team = hands.look(seen)
    found = team.features()
    assert found.shape == (2, 2 * TEAM_FEATURES)
    assert torch.allclose(swapped(team).features(), found.flip(0), atol=1e-5)
    assert torch.allclose(demonstrate(swapped(team)), demonstrate(team).flip(0))
    # The robot that reaches the cube fetches it, and the other one stays at home.
    moved = demonstrate(team)[:, :3].abs().amax(1)
    assert sorted((moved > 0.01).tolist()) == [False, True]


def test_weights_are_loaded_and_an_older_memory_is_kept(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = team_network(hidden=8)
    torch.save(network.state_dict(), tmp_path / "team.pt")
    policy = TeamPolicy(str(tmp_path / "team.pt"))
    seen, first = begun("stack")
    team = first.look(seen)
    rows = policy.rows(team).detach()
    assert rows.shape == (2, len(COLUMNS))
    assert torch.equal(rows, network(team.features()).detach())
    again = copy(first)
    expected = again.command(rows)
    assert expected.shape == (2, 7)
    again.look(seen)
    again.command(rows)
    assert np.array_equal(copy(first).command(rows), expected)


@pytest.mark.parametrize("task", slow_but(["pass", "stack"]))
def test_the_rules_hand_over(task: str) -> None:
    result = lemma.evaluate(
        TeamRules(), level="control", tasks=(task,), split="val", episodes=2, workers=1
    )
    assert all(row["success"] for row in result.rows)


@pytest.mark.parametrize("task", slow_but(["pass", "stack"]))
def test_the_network_that_ships_hands_over(task: str) -> None:
    policy = TeamPolicy(str(Path(__file__).parents[3] / "weights" / "team_hands.pt"))
    result = lemma.evaluate(
        policy, level="control", tasks=(task,), split="val", episodes=3, workers=1
    )
    assert sum(row["success"] for row in result.rows) >= 2
