"""Which words of the unseen templates do the training paraphrases insert?

Run from the repository: ``python scripts/inserted_words.py``. The list in
docs/language.md is computed by this when the pages are built: sentences are drawn as
training draws them, so that the rules of paraphrasing may change.
"""

import re
from collections import Counter

from lemma.core.seeding import stream
from lemma.policies.text.paraphrase import paraphrase
from lemma.tasks.instance import SPLITS
from lemma.tasks.language.bank import templates, vocabulary, words
from lemma.tasks.suite import SUITE, load_instance

DRAWS = 2000
"""Sentences of each task."""
_RARE = 2000
"""A word that less than one sentence in so many has is noise, not a rule."""


def unseen_words() -> dict[str, int]:
    """Return the words that only unseen templates have: in how many of the 80."""
    known = set(vocabulary())
    counted: Counter[str] = Counter()
    for task in SUITE:
        for template in templates(task, "unseen"):
            bare = re.sub(r"\{[^{}]*\}", " ", template.text)
            counted.update(set(words(bare)) - known)
    return dict(sorted(counted.items()))


def inserted_words(draws: int = DRAWS) -> tuple[str, ...]:
    """Return those of them that paraphrases insert, sorted.

    Args:
        draws: Sentences to draw for each task.
    """
    only_unseen = unseen_words()
    counted: Counter[str] = Counter()
    for task in SUITE:
        goals = [
            load_instance(task, "train", index).goal.pairs
            for index in range(min(draws, SPLITS["train"]))
        ]
        for index in range(draws):
            rng = stream("inserted words", task, index)
            goal = goals[index % len(goals)]
            counted.update(set(words(paraphrase(task, goal, rng))) & set(only_unseen))
    least = max(2, draws * len(SUITE) // _RARE)
    return tuple(sorted(word for word, count in counted.items() if count >= least))


if __name__ == "__main__":
    found = inserted_words()
    print(f"{len(found)} of {len(unseen_words())}: {', '.join(found)}")
