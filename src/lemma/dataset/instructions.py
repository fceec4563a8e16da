"""Instructions for training, drawn again in every epoch, without MuJoCo or torch.

A recipe records one sentence of each kind per episode. The templates of a task give
more sentences, from which a model learns more words.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from lemma.core.arguments import known
from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.core.seeding import stream
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.tasks.language.bank import instruct
from lemma.tasks.language.template import KINDS, GoalPairs

TRAINING_KINDS = ("high_level", "human")
"""Kinds of sentences for training; the others are held out."""

_SOURCES = ("recorded", "resampled")


def draw_instruction(
    task: str,
    goal_pairs: GoalPairs,
    key: str,
    *,
    seed: int = 0,
    epoch: int = 0,
    kinds: Sequence[str] = TRAINING_KINDS,
) -> str:
    """Draw a sentence for a goal: first its kind, then its template.

    Args:
        task: Name of the task.
        goal_pairs: The (top, bottom) entities of the goal.
        key: Key of the episode. The same key, seed and epoch give the same sentence, so
            all keyframes of an episode have the same.
        seed: Seed of all draws.
        epoch: Number of the epoch; each has new sentences.
        kinds: Kinds to draw from, with equal probability.

    Raises:
        InvalidConfigError: There are no kinds, or one is not for training.
    """
    for kind in kinds:
        if kind not in TRAINING_KINDS:
            raise InvalidConfigError(
                f"Sentences of kind {kind!r} are not drawn for training. Valid: "
                f"{', '.join(TRAINING_KINDS)}."
            )
    if not kinds:
        raise InvalidConfigError(
            f"No kinds of sentences to draw from. Valid: {', '.join(TRAINING_KINDS)}."
        )
    draws = stream("instruction", seed, epoch, key)
    kind = kinds[int(draws.integers(len(kinds)))]
    return instruct(task, kind, goal_pairs, draws)


def check_recorded(kind: str, splits: Sequence[str]) -> None:
    """Check that recorded sentences may be read.

    Args:
        kind: Kind of sentences.
        splits: Splits of their episodes.

    Raises:
        UnknownNameError: There is no such kind.
        DatasetError: The kind is held out, and a split is for training.
    """
    known("kind of instruction", kind, KINDS)
    if kind not in TRAINING_KINDS and "train" in splits:
        raise DatasetError(
            f"Sentences of kind {kind!r} are held out: they cannot be used with the "
            "split 'train'. Choose split 'val' or 'test', or kind "
            f"{' or '.join(map(repr, TRAINING_KINDS))}."
        )


@dataclass(frozen=True, kw_only=True)
class Language:
    """The source of an episode's instruction."""

    instructions: str = "recorded"
    """``"recorded"``: the sentence in the record. ``"resampled"``: drawn from the
    templates for training, high-level and human, again in every epoch."""
    kind: str = "high_level"
    """Recorded kind: ``high_level``, ``human`` or, except for training, ``unseen``."""
    seed: int = 0
    """Seed of resampled instructions."""

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            UnknownNameError: The source or the kind is unknown.
        """
        known("source of instructions", self.instructions, _SOURCES)
        known("kind of instruction", self.kind, KINDS)

    def choose(self, record: EpisodeRecord, epoch: int = 0) -> str:
        """Return the sentence for an episode of a recipe.

        Args:
            record: The episode.
            epoch: Number of the epoch; each has new sentences if they are resampled.

        Raises:
            DatasetError: The sentence is held out, and the episode is for training.
        """
        if self.instructions == "recorded":
            check_recorded(self.kind, (record.split,))
            recorded: str = getattr(record, self.kind)
            return recorded
        goal = record.instance_data()["goal"]
        return draw_instruction(
            record.task,
            tuple((top, bottom) for top, bottom in goal),
            record.key,
            seed=self.seed,
            epoch=epoch,
        )


RECORDED = Language()
"""Use of the recorded high-level sentences."""
