"""Episodes as evaluation harnesses ask for them: by seed, and judged at their end."""

from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from lemma.core.errors import InvalidConfigError, shown
from lemma.env.base_env import LemmaEnv
from lemma.env.config import RESET_OPTIONS
from lemma.tasks.instance import splits_of

FIGURES = ("is_success", "success", "progress", "elapsed_s", "instance")
"""Keys of ``info`` about an episode; none that a harness might take for observed."""


class HarnessEpisodes(
    gymnasium.Wrapper[Any, Any, Any, Any],
    RecordConstructorArgs,
):
    """The instances of a split in order, for harnesses that count by seeds.

    ``reset(seed=s)`` begins instance ``s - first_seed`` of the split, counted on from
    the first after the last one; without a seed, the instance after the one before.
    ``index``, ``instance`` and ``split`` among the options choose as in the
    environment, and options of others are dropped.

    Harnesses look for success at every step and take any they find.
    ``info["is_success"]`` and ``info["success"]`` are therefore False until the episode
    is over; then they are its verdict. Of the rest, ``info`` keeps :data:`FIGURES`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], first_seed: int = 0) -> None:
        """Begin with the first instance.

        Args:
            env: An environment of this package, with or without wrappers around it.
            first_seed: The seed with which the harness begins.

        Raises:
            InvalidConfigError: It is none.
        """
        RecordConstructorArgs.__init__(self, first_seed=first_seed)
        gymnasium.Wrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, LemmaEnv):
            raise InvalidConfigError(
                f"{shown(inner)} has no instances. Make the environment with "
                "lemma.make or gymnasium.make."
            )
        self._task, self._split = inner.config.task, inner.config.split
        self._first_seed, self._next = first_seed, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; see :meth:`lemma.env.base_env.LemmaEnv.reset`."""
        chosen = {
            name: value
            for name, value in (options or {}).items()
            if name in RESET_OPTIONS
        }
        if not chosen.keys() & {"index", "instance"}:
            index = self._next if seed is None else seed - self._first_seed
            split = chosen.get("split", self._split)
            size = splits_of(self._task).get(split)
            chosen["index"] = index if size is None else index % size
            self._next = chosen["index"] + 1
        observation, info = self.env.reset(seed=seed, options=chosen)
        return observation, _figures(info, over=False)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act once; see the environment's ``step``."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        over = terminated or truncated
        return observation, reward, terminated, truncated, _figures(info, over=over)


def _figures(info: dict[str, Any], *, over: bool) -> dict[str, Any]:
    success = over and bool(info["success"])
    kept = {name: info[name] for name in FIGURES}
    return {**kept, "is_success": success, "success": success}
