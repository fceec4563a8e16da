"""Write the frozen instance lists anew: sampled, solved by the expert, and attacked.

    python scripts/freeze_instances.py src/lemma/tasks/frozen train,val,test 8

The third word is the number of processes. The same version writes the same bytes.
"""

import sys
from pathlib import Path

from lemma.audit.freeze import freeze

if __name__ == "__main__":
    folder, splits, workers = sys.argv[1:]
    for line in freeze(Path(folder), tuple(splits.split(",")), int(workers)):
        print(line, flush=True)
