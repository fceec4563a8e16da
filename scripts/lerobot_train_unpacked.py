r"""lerobot-train on pictures that are decoded once: see lemma.dataset.lerobot.unpacked.

    python scripts/lerobot_train_unpacked.py unpack data/videos /dev/shm/videos
    python scripts/lerobot_train_unpacked.py train /dev/shm/videos \
        --dataset.repo_id=you/lemma --dataset.root=data/videos --policy.type=act ...

What follows the folder of ``train`` are arguments of ``lerobot-train``. What is learned
is the same, to the bit of every sample; it waits for no decoder.
"""

import sys
from importlib import import_module
from pathlib import Path

from lemma.core.workers.pool import ProcessPool
from lemma.core.workers.resources import usable_cores
from lemma.dataset.lerobot.unpacked import read_unpacked, unpack

FORK = "fork"
"""How processes that load samples begin: they share what this one has in memory."""


def main() -> None:
    """Do what the arguments say."""
    match sys.argv[1:]:
        case ["unpack", root, folder]:
            count = unpack(Path(root), Path(folder), ProcessPool(usable_cores()))
            print(f"{folder}: {count} videos.")
        case ["train", folder, *arguments]:
            read_unpacked(Path(folder))
            sys.argv[1:] = [f"--dataloader_multiprocessing_context={FORK}", *arguments]
            import_module("lerobot.scripts.lerobot_train").main()
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
