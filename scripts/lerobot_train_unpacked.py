r"""lerobot-train on pictures that are decoded once: see lemma.dataset.lerobot.unpacked.

    python scripts/lerobot_train_unpacked.py unpack data/videos /dev/shm/videos
    python scripts/lerobot_train_unpacked.py train /dev/shm/videos \
        --dataset.repo_id=you/lemma --dataset.root=data/videos --policy.type=act ...

What follows the folder of ``train`` are arguments of ``lerobot-train``. What is learned
is the same, to the bit of every sample; it waits for no decoder.

With ``--learn-batch-norm`` before them, ACT learns the normalization of its ResNet too.
LeRobot's ACT has it frozen, as it comes with weights of ImageNet; without these it
would be none at all. What is saved is what lerobot reads, frozen from then on.
"""

import sys
from importlib import import_module
from pathlib import Path

from torch.nn import BatchNorm2d

from lemma.core.workers.pool import ProcessPool, usable_cores
from lemma.dataset.lerobot.unpacked import read_unpacked, unpack

LEARN = "--learn-batch-norm"
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
            if LEARN in arguments[:1]:
                arguments.remove(LEARN)
                act = import_module("lerobot.policies.act.modeling_act")
                vars(act)["FrozenBatchNorm2d"] = BatchNorm2d
            sys.argv[1:] = [f"--dataloader_multiprocessing_context={FORK}", *arguments]
            import_module("lerobot.scripts.lerobot_train").main()
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
