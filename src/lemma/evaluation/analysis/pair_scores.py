"""Scores of pairs of which one team can do what the sentence says, and one cannot."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lemma.evaluation.records import Row
from lemma.tasks.language.template import ALL_KINDS


@dataclass(frozen=True)
class PairScores:
    """Numbers of episodes of one kind of instructions."""

    kind: str
    pairs: int
    """Number of pairs of which both episodes were played."""
    right: int
    """Of these, those in which the one was solved and the other one refused."""
    able: int
    """Number of episodes with a team that can do it."""
    solved: int
    refused_wrongly: int
    """Of those, the ones that were refused."""
    unable: int
    """Number of episodes with a team that cannot do it."""
    refused_rightly: int
    explained: int
    """Number of these refusals that name exactly what is out of reach."""
    acted: int
    """Of the episodes that cannot be done, those in which something was tried, or the
    policy failed."""


def pair_scores(rows: Iterable[Row]) -> tuple[PairScores, ...]:
    """Return the scores of the lines of pairs; other lines are skipped."""
    every = [row for row in rows if row.get("pair") is not None]
    by_kind = (
        (kind, [row for row in every if row["instruction_kind"] == kind])
        for kind in ALL_KINDS
    )
    return tuple(_scores(kind, listed) for kind, listed in by_kind if listed)


def _scores(kind: str, rows: Sequence[Row]) -> PairScores:
    able = [row for row in rows if row["pair"]["can"]]
    unable = [row for row in rows if not row["pair"]["can"]]
    solved = {row["index"] // 2 for row in able if row["success"]}
    refused = {row["index"] // 2 for row in unable if row["pair"]["refused"]}
    both = {row["index"] // 2 for row in able} & {row["index"] // 2 for row in unable}
    return PairScores(
        kind,
        len(both),
        len(both & solved & refused),
        len(able),
        len(solved),
        [row["pair"]["refused"] for row in able].count(True),
        len(unable),
        len(refused),
        [row["pair"]["explained"] for row in unable].count(True),
        len(unable) - len(refused),
    )
