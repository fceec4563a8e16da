"""Data: demonstrations of the expert, and their camera images.

python examples/03_data.py [FOLDER]

From a shell: lemma generate, lemma inspect, lemma render. A recipe has a few kB per
episode; images are rendered from it.
"""

import sys
from pathlib import Path

import lemma
from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.recipe.replay import replay
from lemma.dataset.rendered.capture import KeyframeForm
from lemma.dataset.rendered.dataset import KeyframeDataset
from lemma.dataset.rendered.render import RenderConfig, render

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/first-data")
engine = Serial()

# The expert solves the first instances of two splits; existing episodes are kept.
recipe = folder / "recipe"
generate(
    GenerateConfig(out=recipe, tasks=("pass",), splits=("train", "val"), episodes=2),
    engine,
)

for episode in lemma.load(recipe):
    print(episode.key, "|", episode.high_level)
    for step in episode.subtasks:
        print(f"  {step.start_s:5.2f} s  {step.instruction}: {step.outcome}")
    # A replay reproduces every recorded state to the bit.
    print("  exact:", replay(episode).is_exact)

# The view before each sub-task, with the expert's decision.
keyframes = folder / "keyframes"
render(RenderConfig(recipe=recipe, out=keyframes), KeyframeForm(), engine)
frames = KeyframeDataset(keyframes, split="train")
frame = frames[0]
print(len(frames), "keyframes, each with", sorted(frame))
