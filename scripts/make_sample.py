"""Write the sample of published episodes for `lemma doctor --evaluation`.

    python scripts/make_sample.py

The episodes are from results/, except one of the expert at control level, which is
played here.
"""

import json
import tempfile
from pathlib import Path

from lemma.core.workers.pool import Serial
from lemma.evaluation.lines import read_lines
from lemma.evaluation.records import WALL_CLOCK, key_of
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.evaluate import evaluate
from lemma.policies.spec import CONTROL, ORACLE, PolicySpec

ROOT = Path(__file__).parents[1]
FILE = ROOT / "src/lemma/bench/published.json"
KEYS = {
    "reachnet": (
        ("high_level", "pass", 0),
        ("high_level", "hook", 0),
        ("human", "stack", 1),
    ),
    "oracle": (("high_level", "pass2", 0),),
}
"""Kind of instructions, task and index of the episodes, by experiment."""


def main() -> None:
    """Write the file."""
    sample = {}
    for name, keys in KEYS.items():
        rows = read_lines(ROOT / "results" / name / "seed-0.jsonl.xz")
        found = {key_of(row): dict(row) for row in rows}
        sample[name] = [found[key] for key in keys]
    policy = PolicySpec(ORACLE, level=CONTROL)
    with tempfile.TemporaryDirectory() as folder:
        config = EvaluationConfig(
            out=Path(folder),
            policy=policy,
            tasks=("pass",),
            split="test",
            kinds=("high_level",),
            episodes=1,
        )
        played = evaluate(config, Serial())
    sample["control"] = [
        {name: value for name, value in played[0].items() if name not in WALL_CLOCK}
    ]
    FILE.write_text(json.dumps(sample, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
