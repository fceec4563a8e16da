"""Playing pairs: to act where it can be done, and else to refuse with the reason."""

from collections.abc import Sequence

import pytest

from lemma.evaluation.run.pairs import play_pairs, rates
from lemma.policies.interfaces import Decision, PolicyInput
from lemma.tasks.subtask import STOP


class AlwaysRefuses:
    """Says no to everything."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [Decision(STOP, None, "No robot reaches anything.") for _ in inputs]


def test_the_oracle_is_right_and_says_why() -> None:
    (played,) = play_pairs("oracle", [0])
    assert played.right
    assert played.explained
    assert not played.refused_able
    assert played.reason.startswith("No robot reaches the ")
    assert rates([played])["right"] == 1.0


def test_who_refuses_everything_is_wrong() -> None:
    (played,) = play_pairs(f"{__name__}:AlwaysRefuses", [0])
    assert played.refused
    assert played.refused_able
    assert not played.right
    assert not played.explained


@pytest.mark.slow
def test_the_oracle_is_right_in_pairs_of_all_kinds() -> None:
    found = rates(play_pairs("oracle", range(15)))
    assert found["right"] == found["explained"] == 1.0
