"""The dataset card: a README with the header that the Hugging Face Hub reads."""

from pathlib import Path

from lemma.core.files import write_text
from lemma.dataset.recipe.schema import describe, perturbed_as

LICENSE = "Apache-2.0"
"""License of code and data: an SPDX identifier."""
_HEAD = """---
license: {license}
task_categories:
- robotics
language:
- en
tags:
{tags}
pretty_name: {name}
{more}---
"""
_TAGS = ("multi-robot", "language-conditioned", "manipulation", "mujoco")
NAME = "LEMMA Bench demonstrations"

_FILES = """configs:
- config_name: default
  data_files:
  - split: train
    path: train/*.parquet
  - split: validation
    path: val/*.parquet
  - split: test
    path: test/*.parquet
"""

_CARD = """
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

recipe = lemma.load("lemma-v2")  # the folder; 'lemma pull' fetches it
record = recipe.find("hook", "test", 7)
print(record.high_level, [row.instruction for row in record.subtasks])
```

Reading needs neither MuJoCo nor torch, and any library that reads Parquet will do.

The `human` and `unseen` sentences were written by the authors of the package, none is
crowd-sourced. Do not train on `unseen`.

## Columns

{columns}
"""


_PERTURBED_CARD = """
# LEMMA Bench recovery states

These are no demonstrations, and no part of the benchmark. In instances of LEMMA Bench
sub-tasks went wrong on purpose: each with probability {perturb}, drawn with seed
{perturb_seed}. `subtasks` are what was executed, which `lemma replay --validate`
reproduces to the bit. `expert` says what the expert would do at each keyframe: that is
what to learn. It is null where the expert has no plan, failed at what it would do, or
the time was up; what comes behind the first null has no worth as an example.

Benchmark {benchmark}, package {lemma}, MuJoCo {mujoco}, NumPy {numpy}, revision
{revision}.
`manifest.json` holds the checksum of every file.

Train on it beside demonstrations, never instead of them: `lemma render --form
keyframes`, then `lemma train --recovery`. Do not train on `unseen`.

## Columns

{columns}
{more}
"""


def head(*tags: str, name: str = NAME, more: str = "") -> str:
    """Return the header of a card, which the Hugging Face Hub reads.

    Args:
        *tags: Beside those that all cards have.
        name: Name of the dataset.
        more: Further lines of YAML.
    """
    listed = "\n".join(f"- {tag}" for tag in (*tags, *_TAGS))
    # The Hub writes licenses in lower case.
    return _HEAD.format(license=LICENSE.lower(), tags=listed, name=name, more=more)


def write_card(folder: Path, about: dict[str, str]) -> None:
    """Write ``README.md`` of a recipe."""
    if perturbed_as(about):
        more = "\n".join(describe(perturbed=True).splitlines()[2:])
        text = _PERTURBED_CARD.format(columns=describe(), more=more, **about)
        text = head(name="LEMMA Bench recovery states") + text
    else:
        text = head(more=_FILES) + _CARD.format(columns=describe(), **about)
    write_text(folder / "README.md", text)
