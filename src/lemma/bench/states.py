"""Hashes of simulated states, to compare Python versions and machines.

``states.json`` has the hashes of each case after some steps. A case is an instance in
one control mode with fixed random actions, or at the skill level with the expert.
``scripts/hash_states.py`` writes the file.
"""

import hashlib
import struct
from collections.abc import Iterator
from importlib.resources import files
from typing import NamedTuple

import msgspec
import numpy as np

from lemma.core.poses import FloatArray
from lemma.core.seeding import stream
from lemma.env.config import EnvConfig
from lemma.env.control.modes import CONTROLS
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.expert.expert import solve
from lemma.scene.scene import Scene
from lemma.tasks.suite import SUITE, load_instance

FILE = "states.json"
SKILL = "skill"
"""Mode of the cases of the expert, instead of a control mode."""
STEPS = (20, 200)
"""Numbers of control steps before the hashes; the fast comparison ends at the first."""
_KEPT_STEPS = 7
"""Number of control steps with the same action."""
_LEVELS = 2**16
_DIGITS = 16


class Case(NamedTuple):
    """A control mode and a task; the instance is the first of the test split."""

    mode: str
    """Name of a control mode, or :data:`SKILL`."""
    task: str

    @property
    def key(self) -> str:
        """Name of the case in the file."""
        return f"{self.mode}/{self.task}"


def all_cases() -> list[Case]:
    """Return the expert and every control mode, each with every task."""
    return [Case(mode, task) for mode in (SKILL, *CONTROLS) for task in SUITE]


def fast_cases() -> list[Case]:
    """Return the expert and every control mode, each with one task."""
    modes = (SKILL, *CONTROLS)
    return [Case(mode, SUITE[i % len(SUITE)]) for i, mode in enumerate(modes)]


def expected_hashes() -> dict[str, list[str]]:
    """Return the hashes in the package, by the key of a case."""
    text = (files("lemma.bench") / FILE).read_bytes()
    return msgspec.json.decode(text, type=dict[str, list[str]])


def differing(cases: list[Case], *, fast: bool = False) -> list[Case]:
    """Play cases; return those whose states differ from the expected ones.

    Args:
        cases: Cases of :func:`all_cases`.
        fast: Whether to play only to the first hash of each.
    """
    expected, found = expected_hashes(), []
    for case in cases:
        wanted = expected[case.key][: 1 if fast else None]
        if hash_case(case, STEPS[: len(wanted)]) != wanted:
            found.append(case)
    return found


def hash_case(case: Case, steps: tuple[int, ...] = STEPS) -> list[str]:
    """Play a case; return hashes of all states up to each of some numbers of steps.

    The expert's episode has one hash, at its end.
    """
    instance = load_instance(case.task, "test", 0)
    digest = hashlib.sha256()
    if case.mode == SKILL:
        episode = Episode(instance)
        scene = episode.simulation.scene
        for _ in solve(episode):
            _add(digest, scene, episode.elapsed_s)
        return [digest.hexdigest()[:_DIGITS]]
    env = ControlEnv(EnvConfig(task=case.task, control=case.mode, reward="dense"))
    env.set_table(options={"instance": instance})
    scene = env.episode.simulation.scene
    found = []
    actions = _actions(env, case.key)
    for step in range(max(steps)):
        reward, _, _ = env.advance(next(actions))
        _add(digest, scene, reward)
        if step + 1 in steps:
            found.append(digest.hexdigest()[:_DIGITS])
    env.close()
    return found


def _actions(env: ControlEnv, key: str) -> Iterator[FloatArray]:
    """Yield random actions, computed so that they are equal on all machines."""
    rng, layout = stream("states", key), env.action_layout
    low = np.broadcast_to(layout.low, layout.shape)
    high = np.broadcast_to(layout.high, layout.shape)
    while True:
        share = rng.integers(0, _LEVELS, layout.shape, endpoint=True) / _LEVELS
        action = np.clip(low + (high - low) * share, low, high)
        for _ in range(_KEPT_STEPS):
            yield action


def _add(digest: "hashlib._Hash", scene: Scene, number: float) -> None:
    digest.update(scene.snapshot().tobytes())
    digest.update(struct.pack("<d", number))
