"""The instance of the next episode: as ``reset`` asks, or drawn."""

import warnings
from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from typing import Any

import numpy as np

from lemma.core.arguments import whole
from lemma.core.errors import InvalidConfigError, UnknownNameError, shown
from lemma.env.config import EnvConfig
from lemma.env.observation import MAX_INSTRUCTION_LENGTH
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.blind import instruction
from lemma.tasks.sampling import sample
from lemma.tasks.suite import FREE_SPLIT, check_split, load_instance, task_named

RESET_OPTIONS = ("split", "index", "instance")
"""Options of ``reset``."""

_MISSPELLED = 0.75
"""How like one of ours, from 0 to 1, an option is that was meant to be it."""
_SEEDS = 2**31


def own_options(options: object) -> dict[str, Any]:
    """Return the options of ``reset`` that are meant for this package.

    Toolboxes that wrap an environment pass options of their own down to it, so what is
    foreign is ignored, with a warning.

    Args:
        options: Argument of ``reset``.

    Raises:
        InvalidConfigError: It is no dictionary.
        UnknownNameError: One of them looks like a misspelled one of ours.
    """
    if not isinstance(options, Mapping | None):
        raise InvalidConfigError(
            f"options={shown(options)} of reset is no dictionary. Valid: one with any "
            f"of {', '.join(RESET_OPTIONS)}."
        )
    found = {}
    for name, value in (options or {}).items():
        if name in RESET_OPTIONS:
            found[name] = value
        elif get_close_matches(
            str(name).lower(), RESET_OPTIONS, n=1, cutoff=_MISSPELLED
        ):
            raise UnknownNameError("option of reset", name, RESET_OPTIONS)
        else:
            _ignore(str(name)[:100])
    return found


@lru_cache(maxsize=256)
def _ignore(name: str) -> None:
    """Warn that an option is ignored, once in this process."""
    warnings.warn(
        f"The option {name!r} of reset is not one of this environment and is ignored. "
        f"Its options are {', '.join(RESET_OPTIONS)}.",
        stacklevel=2,
    )


class InstanceSource:
    """Finds instances for an environment."""

    def __init__(self, config: EnvConfig) -> None:
        """Find instances of the task, split and team that a configuration names."""
        self._config = config

    def choose(self, options: Mapping[str, Any], rng: np.random.Generator) -> Instance:
        """Return what an episode is about.

        Args:
            options: Options of ``reset``; see :func:`own_options`.
            rng: Draws, where nothing is named.

        Raises:
            UnknownNameError: No such split.
            InvalidConfigError: There is no such instance, or it cannot be used.
        """
        instance = options.get("instance")
        if instance is None:
            split = options.get("split", self._config.split)
            check_split(self._config.task, split)
            index = options.get("index", self._config.index)
            drawn = index is None
            instance = self._draw(split, rng) if drawn else self._load(split, index)
        self.check(instance)
        return instance

    def check(self, instance: object) -> None:
        """Check that an environment can be set up for an instance.

        Raises:
            InvalidConfigError: It is none, of another team, or cannot be instructed.
        """
        if not isinstance(instance, Instance):
            raise InvalidConfigError(
                f"{shown(instance)} is no instance. Try lemma.load_instance(task, "
                "split, index), or lemma.Instance.from_dict of what to_dict() gave."
            )
        arms = tuple(robot.arm for robot in instance.scene.robots)
        count = self._config.team_size
        if len(arms) != count or not self._has_team(instance):
            raise InvalidConfigError(
                f"Instance {instance.key} has the team {arms}, but this environment is "
                f"for {self._config.robots or f'{count} robots'}. Choose another "
                "index, or make the environment with robots=None."
            )
        kind = self._config.instruction
        text = instruction(instance, kind)
        if len(text) > MAX_INSTRUCTION_LENGTH or not text.isascii():
            raise InvalidConfigError(
                f"The instruction {shown(text)} cannot be observed. It must be ASCII "
                f"and at most {MAX_INSTRUCTION_LENGTH} characters long."
            )

    def _draw(self, split: str, rng: np.random.Generator) -> Instance:
        task, robots = self._config.task, self._config.robots
        if split == FREE_SPLIT:
            return self._load(split, rng.integers(_SEEDS))
        for index in rng.permutation(SPLITS[split]):
            instance = load_instance(task, split, int(index))
            if self._has_team(instance):
                return instance
        raise InvalidConfigError(
            f"Split {split!r} of {task!r} has no instance with the team {robots!r}. "
            f"Use split {FREE_SPLIT!r}, or another team."
        )

    def _load(self, split: str, index: Any) -> Instance:
        task, robots = self._config.task, self._config.robots
        if split == FREE_SPLIT:
            return _sampled(task, whole("index", index, 0), robots)
        return load_instance(task, split, index)

    def _has_team(self, instance: Instance) -> bool:
        robots = self._config.robots
        arms = [robot.arm for robot in instance.scene.robots]
        return robots is None or sorted(robots) == sorted(arms)


@lru_cache(maxsize=256)
def _sampled(task: str, index: int, team: tuple[str, ...] | None) -> Instance:
    """Sample a free instance; some take seconds, so the last ones are kept."""
    return sample(task_named(task), FREE_SPLIT, index, team=team).instance
