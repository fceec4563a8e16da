"""Draw the learning curves of PPO on a GPU from what the trainings printed.

python scripts/gpu_curves.py

Reads results/gpu/RUNG-SEED.txt, the output of ``scripts/learn_on_a_gpu.py``, and writes
docs/images/gpu_learning.svg.
"""

import re
from pathlib import Path

from lemma.evaluation.analysis.rates import wilson_interval
from lemma.viz.plots import Mark, Series, lines, standalone

HOME = Path(__file__).parents[1]
LOGS, FIGURE = HOME / "results" / "gpu", HOME / "docs" / "images" / "gpu_learning.svg"
_LINE = re.compile(r"^(\d+) steps, (\d+) s: (\d+)% of (\d+) succeeded", re.MULTILINE)


def curve(text: str) -> dict[int, Mark]:
    """Return a mark for each million steps of a training.

    Args:
        text: Its output.
    """
    found = {}
    for line in _LINE.finditer(text):
        steps, seconds, percent, ended = map(int, line.groups())
        share = percent / 100.0
        low, high = wilson_interval(round(share * ended), ended)
        words = f"{steps:,} steps, {seconds} s: {percent} % of {ended} episodes"
        found[round(steps / 1e6)] = Mark(share, low, high, words)
    return found


def figure(logs: Path = LOGS) -> str:
    """Return the figure of all trainings in a folder."""
    curves = {path.stem: curve(path.read_text()) for path in sorted(logs.glob("*.txt"))}
    last = max(max(marks) for marks in curves.values())
    series = [
        Series(
            "{}_varied, seed {}".format(*name.split("-")),
            tuple(marks.get(million) for million in range(last + 1)),
        )
        for name, marks in curves.items()
    ]
    words = ("steps [million]", "success in training [%]")
    return standalone(lines([str(k) for k in range(last + 1)], series, words))


if __name__ == "__main__":
    FIGURE.write_text(figure())
