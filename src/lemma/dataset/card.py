"""The dataset card: a README with the header that the Hugging Face Hub reads."""

from pathlib import Path

from lemma.dataset.files import write_text
from lemma.dataset.schema import describe

_CARD = """---
license: cc-by-4.0
task_categories:
- robotics
language:
- en
tags:
- multi-robot
- language-conditioned
- manipulation
- mujoco
pretty_name: LEMMA Bench demonstrations
configs:
- config_name: default
  data_files:
  - split: train
    path: train/*.parquet
  - split: validation
    path: val/*.parquet
  - split: test
    path: test/*.parquet
---

# LEMMA Bench demonstrations

Expert demonstrations of the eight tasks of LEMMA Bench: two robot arms, one table,
one sentence. This is the *recipe* form: no pictures, but the instance, the sub-tasks
and the full physics state at every keyframe. `lemma render` makes pictures of it, and
`lemma replay --validate` reproduces every state to the bit.

Benchmark {benchmark}, package {lemma}, MuJoCo {mujoco}, NumPy {numpy}, revision
{revision}.
`manifest.json` holds the checksum of every file.

```python
import lemma

recipe = lemma.load("lemma-v1")  # the folder; 'lemma pull' fetches it
record = recipe.find("hook", "test", 7)
print(record.high_level, [row.instruction for row in record.subtasks])
```

Reading needs neither MuJoCo nor torch, and any library that reads Parquet will do.

The `human` and `unseen` sentences were written by the authors of the package, none is
crowd-sourced. Do not train on `unseen`.

## Columns

{columns}
"""


def write_card(folder: Path, about: dict[str, str]) -> None:
    """Write ``README.md`` of a recipe."""
    text = _CARD.format(columns=describe(), **about)
    write_text(folder / "README.md", text)
