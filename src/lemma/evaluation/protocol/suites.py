"""The definitions of the suites beside the paper's, each with a hash of its own.

The protocol holds the rules of all episodes and the paper's suite. The other suites are
played by the same rules. The definition of each is hashed apart, so that a suite may
grow without a change of the protocol that all published results quote. The page
``docs/protocol.md`` has these hashes, and a test compares.
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

OTHERS = tuple(name for name, tasks in SUITES.items() if tasks != SUITE)
"""Names of the suites beside the paper's."""
_SUCCESS: dict[str, dict[str, float]] = {
    "ladder": {"over_m": OVER_M, "hover_m": HOVER_M, "lifted_m": LIFTED_M},
}
"""By what goals are judged that the protocol does not have."""
_REFUSED: dict[str, dict[str, list[str]]] = {
    "teams": {"refused": [Outcome.OVERLOAD.value]},
}
"""Outcomes of what a robot cannot do that the protocol does not have."""


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
    """Return what defines one of :data:`OTHERS`, ready for JSON."""
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
    """Return what a result quotes beside the protocol: the hash of each other suite.

    Args:
        tasks: Those that are played. The paper's eight are in the protocol, also where
            another suite has them.
    """
    played = {*tasks} - {*SUITE}
    return {
        suite: sha256_of(definition(suite))
        for suite in OTHERS
        if played & {*SUITES[suite]}
    }


def other_suites(about: Mapping[str, Any], than: Mapping[str, str]) -> list[str]:
    """Return the suites that a result has, and that are defined otherwise here.

    Args:
        about: Settings of the result, as in ``about.json``. Older ones quote no suites.
        than: Hashes by name of the suite.
    """
    quoted = about.get("suites", {})
    return [name for name in quoted if than.get(name, quoted[name]) != quoted[name]]
