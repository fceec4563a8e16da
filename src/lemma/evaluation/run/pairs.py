"""Pairs of which one can be done: to act on the one, and to refuse the other.

A policy refuses by deciding to stop before anything was done, with an explanation that
says who lacks what. It is played by the same rules as everywhere, one robot at a time.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.entity import entity_named
from lemma.tasks.teams.pairs import Pair, sample_pair


@dataclass(frozen=True, slots=True)
class PlayedPair:
    """A policy's record with a pair."""

    index: int
    solved: bool
    """Whether it solved the instance that can be solved, strictly."""
    refused_able: bool
    """Whether it refused that one, which is wrong."""
    refused: bool
    """Whether it refused the one that cannot be solved."""
    explained: bool
    """Whether it named all that is out of reach, and nothing else of the goal."""
    reason: str
    """Its words then."""

    @property
    def right(self) -> bool:
        """Whether it did what can be done, and refused what cannot."""
        return self.solved and self.refused


def play_pairs(
    policy: str, indices: Iterable[int], kind: str = "high_level"
) -> Iterator[PlayedPair]:
    """Let a policy play pairs, yielding each when both of it are over.

    Args:
        policy: Its name, as for ``lemma evaluate --policy``.
        indices: Of the pairs, see :func:`~lemma.tasks.teams.pairs.sample_pair`.
        kind: Kind of the sentences.

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
    """Whether a reason names what is lacking alone."""
    named = {n for n in pair.unable.goal.entities if entity_named(n).phrase in reason}
    return named == {*pair.lack.things}


def rates(played: Iterable[PlayedPair]) -> dict[str, float]:
    """Return shares of pairs: of those that are right, and of each half of that."""
    every = list(played)
    columns = ("right", "solved", "refused", "explained", "refused_able")
    return {
        name: [getattr(one, name) for one in every].count(True) / max(1, len(every))
        for name in columns
    }
