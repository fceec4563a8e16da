"""A request of the page: an instance, a sentence, and a policy."""

from dataclasses import dataclass

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.policies.spec import ORACLE
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.suite import FREE_SPLIT, SUITE, load_instance

OWN_WORDS = "your own words"
SAYINGS = (*KINDS, OWN_WORDS)
"""Kinds of sentences: those of the instance, or any."""
LONGEST = 300
"""Characters of a sentence that are read."""


@dataclass(frozen=True, slots=True)
class EpisodeRequest:
    """An instance, a sentence, and the policy that follows it."""

    task: str = SUITE[0]
    split: str = "test"
    index: int = 0
    saying: str = SAYINGS[0]
    """One of :data:`SAYINGS`."""
    text: str = ""
    """A sentence in own words."""
    policy: str = ORACLE
    own: Instance | None = None
    """An own instance, instead of that of the task's list."""

    def __post_init__(self) -> None:
        """Check the names and the length of the sentence.

        Raises:
            UnknownNameError: No such split or kind of sentence.
            InvalidConfigError: The sentence is too long.
        """
        splits = (*SPLITS, FREE_SPLIT)
        if self.split not in splits:
            raise UnknownNameError("split", self.split, splits)
        if self.saying not in SAYINGS:
            raise UnknownNameError("kind of sentence", self.saying, SAYINGS)
        if len(self.text) > LONGEST:
            raise InvalidConfigError(
                f"The sentence has {len(self.text)} characters; say it in {LONGEST}."
            )

    def instance(self) -> Instance:
        """Return the instance.

        Raises:
            LemmaError: There is no such instance.
        """
        return self.own or load_instance(self.task, self.split, self.index)
