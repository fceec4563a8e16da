"""Freeze the protocol, and write docs/protocol.md from it.

Run from the repository: ``python scripts/protocol.py``. If a protocol has results, a
changed one needs a new name, ``NAME`` in ``lemma.evaluation.protocol.rules``.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lemma.core.workers.resumable import flat
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

- **Results quote it.** It is computed from the code, the data and the
  version of MuJoCo when an evaluation begins; `about.json` and every summary hold the
  hash. With another release of MuJoCo it is another one.
- **Protocols are not mixed.** `lemma evaluate` refuses a folder of another protocol;
  `lemma report`, `lemma reproduce` and `lemma compare` refuse results of different
  ones.
- **Free choices** stand beside it in `about.json`: the policy with its weights, the
  split, what is said (`--language`), and where objects begin (`--perturb-start`).
- **Skills are held by their effect.** The expert's time for every frozen instance of
  val and test is part of the protocol: whoever changes skills, physics or the expert
  changes it.
- **Other suites have a hash each**, of their tasks, lists and goals, which results
  quote beside the protocol's under `suites`; so the protocol stays when they grow.
  Results with different lists of a suite are not mixed. `pass`, `stack`, `poke` and
  `hook` are of the protocol. There are no blind sentences and no times of the expert
  for the other tasks.

[](evaluation.md) explains the words.
"""


def text(protocol: Mapping[str, Any]) -> str:
    """Return the page of a protocol."""
    page = _INTRODUCTION.format(
        name=protocol["name"],
        sha256=sha256_of(protocol),
        suites="\n".join(
            f"| suite `{suite}` | `{sha256_of(definition(suite))}` |"
            for suite in OTHERS
        ),
    )
    simple = {k: v for k, v in protocol.items() if not isinstance(v, Mapping)}
    page += _table("In general", {k: v for k, v in simple.items() if k != "name"})
    for title, part in protocol.items():
        if isinstance(part, Mapping):
            heading = title.replace("_", " ").replace("sha256", "by SHA-256")
            page += _table(heading[0].upper() + heading[1:], dict(flat(part)))
    return page


def _table(title: str, values: Mapping[str, Any]) -> str:
    lines = [f"| `{name}` | {_shown(v)} |" for name, v in values.items()]
    return f"\n## {title}\n\n| what | value |\n|:---|:---|\n" + "\n".join(lines) + "\n"


def _shown(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(f"`{one}`" for one in value)
    if isinstance(value, str) and " " not in value:
        return f"`{value}`"
    return str(value)


if __name__ == "__main__":
    now = in_force()
    FILE.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(text(now), encoding="utf-8")
