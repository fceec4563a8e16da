"""Freeze the protocol, and write docs/protocol.md from it.

Run from the repository: ``python scripts/protocol.py``. If a protocol has results, a
changed one needs a new name, ``NAME`` in ``lemma.evaluation.protocol.rules``.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lemma.evaluation.protocol.rules import PROTOCOL, in_force
from lemma.evaluation.protocol.suites import OTHERS, definition, sha256_of

ROOT = Path(__file__).parents[1]
FILE = ROOT / "src" / "lemma" / "evaluation" / "protocol" / PROTOCOL
PAGE = ROOT / "docs" / "protocol.md"
_INTRODUCTION = """\
# Protocol

Everything that fixes a number, as one frozen file: `protocol.json` in
`lemma.evaluation.protocol`. `python scripts/protocol.py` writes this page from it.

| protocol | SHA-256 |
|:---|:---|
| `{name}` | `{sha256}` |
{suites}

- **Results quote it.** It is computed when an evaluation begins; `about.json` and every
  summary hold the hash.
- **Protocols are not mixed**, neither in a folder of `lemma evaluate` nor by
  `lemma report`, `lemma reproduce` and `lemma compare`.
- **Free choices** stand beside it in `about.json`: the policy with its weights, the
  split, `--language` and `--perturb-start`.
- **Skills are held by their effect**: the expert's times on all instances of val and
  test are part of the protocol.
- **Other suites have a hash each**, of their tasks, lists and goals, under `suites` in
  results. `pass`, `stack`, `poke` and `hook` are of the protocol. The other tasks have
  no blind sentences and no times of the expert.
- **[Relational sentences](language.md#relational-instructions)** are beside it: results
  with them quote the protocol, and their lines hold the sentence.

[](evaluation.md) explains the words. The SHA-256 of each list of instances stands in
`protocol.json` alone; the rest of the file:

```{{protocol}}
```
"""


def text(protocol: Mapping[str, Any]) -> str:
    """Return the page of a protocol."""
    return _INTRODUCTION.format(
        name=protocol["name"],
        sha256=sha256_of(protocol),
        suites="\n".join(
            f"| suite `{suite}` | `{sha256_of(definition(suite))}` |"
            for suite in OTHERS
        ),
    )


if __name__ == "__main__":
    now = in_force()
    FILE.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(text(now), encoding="utf-8")
