"""`lemma push-to-hub`: publish a dataset."""

from typing import Annotated

import tyro

from lemma.cli.options import Data, Flag, messages, output
from lemma.dataset.hub import push

Repository = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="OWNER/NAME")]
"""A repository of the Hub."""


def push_to_hub(data: Data, repository: Repository, private: Flag = False) -> int:
    """Check a dataset and upload it to the Hugging Face Hub.

    Args:
        data: Folder of the dataset.
        repository: Repository on the Hub; created if it is missing.
        private: Create it as a private repository.
    """
    messages().print(f"Uploading {data} to {repository} ...")
    address = push(data, repository, private=private)
    output().print(address, style="bold", soft_wrap=True)
    return 0
