"""`lemma pull`: fetch a dataset, or weights."""

from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.options import Word, messages, output, words
from lemma.core.errors import InvalidConfigError
from lemma.dataset.hub import pull as fetch

Source = Annotated[
    str | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="OWNER/NAME", help_behavior_hint=""),
]
"""A repository of the Hub."""
Out = Annotated[
    Path | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="OUT", help_behavior_hint=""),
]
"""A folder to write to."""
Names = Annotated[
    tuple[str, ...] | None,
    tyro.conf.arg(metavar="[NAME ...]", help_behavior_hint=""),
]
"""Names of published weights; all if none is given."""


def pull(
    repository: Source = None,
    out: Out = None,
    split: Word = None,
    revision: Word = None,
    weights: Names = None,
) -> int:
    """Fetch a dataset from the Hugging Face Hub, or published weights.

    Args:
        repository: Repository of a dataset on the Hub.
        out: Folder for the dataset; existing files are not fetched again.
        split: Only these splits, separated by commas.
        revision: Branch, tag or commit; the main branch by default.
        weights: Fetch published weights instead, all of them or the named ones, in the
            revision for this version. Existing files are kept.
    """
    if weights is not None:
        if repository or out or split or revision:
            raise InvalidConfigError(
                "--weights takes only names of weights, such as lemma pull --weights "
                "reachnet. Fetch a dataset with another command."
            )
        return _pull_weights(weights)
    if repository is None or out is None:
        raise InvalidConfigError(
            "Name a dataset, lemma pull OWNER/NAME OUT; or weights, lemma pull "
            "--weights [NAME ...]."
        )
    messages().print(f"Fetching {repository} ...")
    splits = () if split is None else words(split)
    folder = fetch(repository, out, revision=revision, splits=splits)
    output().print(f"{folder}", style="bold", soft_wrap=True)
    return 0


def _pull_weights(names: tuple[str, ...]) -> int:
    # Import late: torch is optional, and datasets do not need it.
    from lemma.policies.weights import find_published, published_weights

    for name in names or published_weights():
        path = find_published(name)
        output().print(f"{name}: {path}", soft_wrap=True)
    return 0
