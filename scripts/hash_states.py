"""Write the expected hashes of states for ``lemma doctor``; it takes a minute.

    python scripts/hash_states.py

The hashes may change only with the version of the benchmark or of MuJoCo.
"""

import json
from pathlib import Path

from lemma.bench import states

if __name__ == "__main__":
    path = Path(states.__file__).with_name(states.FILE)
    rows = [
        f"{json.dumps(case.key)}: {json.dumps(states.hash_case(case))}"
        for case in states.all_cases()
    ]
    path.write_text("{\n" + ",\n".join(rows) + "\n}\n")
    print(f"{len(rows)} cases: {path}")
