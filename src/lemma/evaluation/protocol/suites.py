"""The definitions of the suites besides the paper's, each with its own hash.

The protocol has the rules of all episodes and the paper's suite. The other suites
follow the same rules. Each has its own hash, so that an addition to a suite does not
change the protocol, which all published results quote. ``docs/protocol.md`` has these
hashes, and a test compares them.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from lemma.motion.outcome import Outcome
from lemma.tasks.goal import HOVER_M, LIFTED_M, OVER_M
from lemma.tasks.instance import BENCHMARK_VERSION, splits_of
from lemma.tasks.names import SUITE, SUITES
from lemma.tasks.teams.rule import AT_ONCE_S

OTHERS = tuple(name for name, tasks in SUITES.items() if tasks != SUITE)
"""Names of the suites besides the paper's."""
_SUCCESS: dict[str, dict[str, float]] = {
    "ladder": {"over_m": OVER_M, "hover_m": HOVER_M, "lifted_m": LIFTED_M},
    "teams": {"at_once_s": AT_ONCE_S},
}
"""Criteria of goals and rules that are not in the protocol."""
_REFUSED: dict[str, dict[str, list[str]]] = {
    "teams": {"refused": [Outcome.OVERLOAD.value]},
}
"""Outcomes of infeasible sub-tasks that are not in the protocol."""


def sha256_of(protocol: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a protocol, or a suite's definition, as canonical JSON."""
    text = json.dumps(protocol, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def lists_of(tasks: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each frozen list of some tasks, by its name, in order."""
    path = files("lemma.tasks") / "frozen" / "manifest.json"
    lists = json.loads(path.read_bytes())
    wanted = {*tasks}
    return {
        name: lists[name]["sha256"]
        for name in sorted(lists)
        if name.rpartition("-")[0] in wanted
    }


@cache
def definition(suite: str) -> dict[str, Any]:
    """Return the definition of one of :data:`OTHERS`, ready for JSON."""
    tasks = SUITES[suite]
    return {
        "suite": suite,
        "benchmark": BENCHMARK_VERSION,
        "tasks": list(tasks),
        "episodes_per_task": {task: dict(splits_of(task)) for task in tasks},
        "lists_sha256": lists_of(tasks),
        "success": _SUCCESS.get(suite, {}),
        **_REFUSED.get(suite, {}),
    }


def quote_suites(tasks: Iterable[str]) -> dict[str, str]:
    """Return the hash of each other suite of some tasks, which results quote.

    Args:
        tasks: Names of the tasks. The paper's eight tasks are in the protocol, even if
            another suite has them, too.
    """
    played = {*tasks} - {*SUITE}
    return {
        suite: sha256_of(definition(suite))
        for suite in OTHERS
        if played & {*SUITES[suite]}
    }


def other_suites(about: Mapping[str, Any], than: Mapping[str, str]) -> list[str]:
    """Return the suites of a result whose hashes differ from given ones.

    Args:
        about: Settings of the result, as in ``about.json``. Older ones have no hashes
            of suites.
        than: Hashes by name of the suite.
    """
    quoted = about.get("suites", {})
    return [name for name in quoted if than.get(name, quoted[name]) != quoted[name]]
