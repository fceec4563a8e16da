"""The table of pairs of which one cannot be done: solved, refused, tried."""

from collections.abc import Iterable

from lemma.core.tables import Table
from lemma.evaluation.analysis.pair_scores import PairScores

_NAMES = (
    "pairs right",
    "solved",
    "refused rightly",
    "... with the reason",
    "refused wrongly",
    "acted though impossible",
)


def pair_table(columns: Iterable[tuple[str, PairScores]]) -> Table:
    """Return how often policies act and refuse, each in a column.

    Args:
        columns: Titles and scores.
    """
    titles, scores = zip(*columns, strict=True)
    counted = zip(*map(_cells, scores), strict=True)
    rows = [(name, *cells) for name, cells in zip(_NAMES, counted, strict=True)]
    return Table(("", *titles), tuple(rows))


def _cells(one: PairScores) -> tuple[str, ...]:
    able, unable = one.able, one.unable
    counts = (
        (one.right, one.pairs),
        (one.solved, able),
        (one.refused_rightly, unable),
        (one.explained, unable),
        (one.refused_wrongly, able),
        (one.acted, unable),
    )
    return tuple(f"{count} of {whole}" for count, whole in counts)
