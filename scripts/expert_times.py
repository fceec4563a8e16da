"""Write the table of the expert's times anew: val and test, perturbed starts too.

    python scripts/expert_times.py 2

The word is the number of processes. The same version writes the same bytes.
"""

import json
import sys
from pathlib import Path

from lemma.core.parallel import ProcessPool
from lemma.evaluation.run.expert_times import TIMES, time_all

TABLE = Path(__file__).parents[1] / "src" / "lemma" / "evaluation" / TIMES

if __name__ == "__main__":
    table = time_all(ProcessPool(int(sys.argv[1])))
    lines = [
        f'"{split}": {{\n'
        + ",\n".join(
            f' "{task}": {{\n'
            + ",\n".join(f'  "{k}": {json.dumps(v)}' for k, v in entry.items())
            + "\n }"
            for task, entry in tasks.items()
        )
        + "\n}"
        for split, tasks in table.items()
    ]
    TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
