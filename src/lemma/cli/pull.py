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
        out: Folder for the dataset; what is there already is not fetched again.
        split: Only these splits, separated by commas.
        revision: Branch, tag or commit; the main branch by default.
        weights: Fetch published weights instead, all of them or those that are named,
            in the revision that belongs to this version. Files that are here already
            stay.
    """
    if weights is not None:
        if repository or out or split or revision:
            raise InvalidConfigError(
                "--weights takes names of weights alone, such as lemma pull --weights "
                "reachnet. A dataset is fetched by another command."
            )
        return _pull_weights(weights)
    if repository is None or out is None:
        raise InvalidConfigError(
            "Say what to fetch: lemma pull OWNER/NAME OUT, a dataset; or lemma pull "
            "--weights [NAME ...]."
        )
    messages().print(f"Fetching {repository} ...")
    splits = () if split is None else words(split)
    folder = fetch(repository, out, revision=revision, splits=splits)
    output().print(f"{folder}", style="bold", soft_wrap=True)
    return 0


def _pull_weights(names: tuple[str, ...]) -> int:
    # torch is an extra, which datasets do without.
    from lemma.policies.weights import find_published, published_weights

    for name in names or published_weights():
        path = find_published(name)
        output().print(f"{name}: {path}", soft_wrap=True)
    return 0
