"""`lemma pull`: fetch a dataset."""

from pathlib import Path
from typing import Annotated

import tyro

from lemma.cli.generate import words
from lemma.cli.options import Word, messages, output
from lemma.cli.push_to_hub import Repository
from lemma.dataset.hub import pull as fetch

Out = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
"""A folder to write to."""


def pull(
    repository: Repository, out: Out, split: Word = None, revision: Word = None
) -> int:
    """Fetch a dataset from the Hugging Face Hub, and check it.

    Args:
        repository: Repository on the Hub.
        out: Folder for the dataset; what is there already is not fetched again.
        split: Only these splits, separated by commas.
        revision: Branch, tag or commit; the main branch by default.
    """
    messages().print(f"Fetching {repository} ...", markup=False)
    splits = () if split is None else words(split)
    folder = fetch(repository, out, revision=revision, splits=splits)
    output().print(f"{folder}", style="bold", markup=False, soft_wrap=True)
    return 0
