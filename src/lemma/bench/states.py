"""Hashes of simulated states, to compare another Python or machine with.

``states.json`` has the hash of each case after some steps. A case is an instance
played in one control mode with fixed random actions, or at the skill level by the
expert. ``scripts/hash_states.py`` writes the file.
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
from lemma.expert.expert import Expert, solve
from lemma.scene.scene import Scene
from lemma.tasks.suite import SUITE, load_instance

FILE = "states.json"
SKILL = "skill"
"""Stands for the expert where other cases have the name of a control mode."""
STEPS = (20, 200)
"""Control steps after which a case is hashed; the fast comparison ends at the first."""
_KEPT_STEPS = 7
"""How many control steps an action is repeated for."""
_LEVELS = 2**16
_DIGITS = 16


class Case(NamedTuple):
    """A control mode and a task; the instance is the first of the test split."""

    mode: str
    """Name of a control mode, or :data:`SKILL`."""
    task: str

    @property
    def key(self) -> str:
        """Its name in the file."""
        return f"{self.mode}/{self.task}"


def all_cases() -> list[Case]:
    """Return the expert and every control mode, each with every task."""
    return [Case(mode, task) for mode in (SKILL, *CONTROLS) for task in SUITE]


def fast_cases() -> list[Case]:
    """Return the expert and every control mode, each with one task."""
    modes = (SKILL, *CONTROLS)
    return [Case(mode, SUITE[i % len(SUITE)]) for i, mode in enumerate(modes)]


def expected_hashes() -> dict[str, list[str]]:
    """Return the hashes that ship with the package, by the key of a case."""
    text = (files("lemma.bench") / FILE).read_bytes()
    return msgspec.json.decode(text, type=dict[str, list[str]])


def differing(cases: list[Case], *, fast: bool = False) -> list[Case]:
    """Play cases; return those that led to other states than expected.

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
    """Play a case; return a hash of all states on the way after so many steps each.

    The expert's episode has one hash, after its end.
    """
    instance = load_instance(case.task, "test", 0)
    digest = hashlib.sha256()
    if case.mode == SKILL:
        episode = Episode(instance)
        scene = episode.simulation.scene
        for _ in solve(episode, Expert(scene, instance.goal)):
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
    """Yield random actions without end, which no library or processor rounds."""
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
