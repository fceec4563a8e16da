"""Print the words of the unseen templates that the training paraphrases insert.

Run from the repository: ``python scripts/inserted_words.py``. The build of the pages
computes the list in docs/language.md with this module, from sentences drawn as in
training, so the list follows changes of the paraphrases.
"""

import re
from collections import Counter

from lemma.core.seeding import stream
from lemma.policies.text.paraphrase import paraphrase
from lemma.tasks.instance import SPLITS
from lemma.tasks.language.bank import templates, vocabulary, words
from lemma.tasks.suite import SUITE, load_instance

DRAWS = 2000
"""Number of sentences of each task."""
_RARE = 2000
"""Words in less than one of so many sentences are ignored as noise."""


def unseen_words() -> dict[str, int]:
    """Return the words in unseen templates alone, with their number of templates."""
    known = set(vocabulary())
    counted: Counter[str] = Counter()
    for task in SUITE:
        for template in templates(task, "unseen"):
            bare = re.sub(r"\{[^{}]*\}", " ", template.text)
            counted.update(set(words(bare)) - known)
    return dict(sorted(counted.items()))


def inserted_words(draws: int = DRAWS) -> tuple[str, ...]:
    """Return the words of :func:`unseen_words` that paraphrases insert, sorted.

    Args:
        draws: Number of sentences to draw for each task.
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
