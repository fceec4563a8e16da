"""Pairs of a feasible and an infeasible instance: solve the one, refuse the other.

A policy refuses if its first decision is to stop, with an explanation of what is out of
whose reach. The rules are those of other episodes, with one robot at a time.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.entity import entity_named
from lemma.tasks.teams.pairs import Pair, sample_pair


@dataclass(frozen=True, slots=True)
class PlayedPair:
    """A policy's result for a pair."""

    index: int
    solved: bool
    """Whether it solved the feasible instance, strictly."""
    refused_able: bool
    """Whether it refused the feasible instance, which is wrong."""
    refused: bool
    """Whether it refused the infeasible instance."""
    explained: bool
    """Whether it named everything that is out of reach, and nothing else of the
    goal."""
    reason: str
    """Its explanation of the refusal."""

    @property
    def right(self) -> bool:
        """Whether it solved the feasible instance, and refused the other."""
        return self.solved and self.refused


def play_pairs(
    policy: str, indices: Iterable[int], kind: str = "high_level"
) -> Iterator[PlayedPair]:
    """Play pairs with a policy, yielding each after both of its episodes.

    Args:
        policy: Name of the policy, as for ``lemma evaluate --policy``.
        indices: Indices of pairs, see :func:`~lemma.tasks.teams.pairs.sample_pair`.
        kind: Kind of instruction.

    Raises:
        LemmaError: There is no such policy, or no such pair.
    """
    player = Player.load(PolicySpec(policy))
    for index in indices:
        pair = sample_pair(index)
        able, unable = (Rollout(one, kind) for one in (pair.able, pair.unable))
        for _ in roll_out((able, unable), player, 1, lenient=False):
            pass
        yield PlayedPair(
            index,
            able.success,
            able.refusal is not None,
            unable.refusal is not None,
            _explains(unable.refusal or "", pair),
            unable.refusal or "",
        )


def _explains(reason: str, pair: Pair) -> bool:
    """Return whether an explanation names exactly what is out of reach."""
    named = {n for n in pair.unable.goal.entities if entity_named(n).phrase in reason}
    return named == {*pair.lack.things}


def rates(played: Iterable[PlayedPair]) -> dict[str, float]:
    """Return the shares of right pairs, and of each part of the result, by name."""
    every = list(played)
    columns = ("right", "solved", "refused", "explained", "refused_able")
    return {
        name: [getattr(one, name) for one in every].count(True) / max(1, len(every))
        for name in columns
    }
