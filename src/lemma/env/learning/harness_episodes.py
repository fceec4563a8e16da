"""Episodes for evaluation harnesses: chosen by seed, and judged at their end."""

from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from lemma.core.errors import InvalidConfigError, shown
from lemma.env.base_env import LemmaEnv
from lemma.env.config import RESET_OPTIONS
from lemma.tasks.instance import splits_of

FIGURES = ("is_success", "success", "progress", "elapsed_s", "instance")
"""Keys of ``info`` that are kept; none that a harness might treat as an observation."""


class HarnessEpisodes(
    gymnasium.Wrapper[Any, Any, Any, Any],
    RecordConstructorArgs,
):
    """A wrapper that plays the instances of a split in order, by seed.

    ``reset(seed=s)`` starts instance ``s - first_seed`` of the split, modulo its
    length; without a seed, it starts the next instance. The options ``index``,
    ``instance`` and ``split`` work as in the environment; unknown options are dropped.

    Harnesses check for success at every step. ``info["is_success"]`` and
    ``info["success"]`` are therefore False until the episode is over; then they are its
    verdict. ``info`` keeps only :data:`FIGURES`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], first_seed: int = 0) -> None:
        """Begin with the first instance.

        Args:
            env: An environment of this package, with or without wrappers around it.
            first_seed: The first seed of the harness.

        Raises:
            InvalidConfigError: ``env`` is no environment of this package.
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
        """Start an episode; see :meth:`lemma.env.base_env.LemmaEnv.reset`."""
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
        """Execute one action; see the environment's ``step``."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        over = terminated or truncated
        return observation, reward, terminated, truncated, _figures(info, over=over)


def _figures(info: dict[str, Any], *, over: bool) -> dict[str, Any]:
    success = over and bool(info["success"])
    kept = {name: info[name] for name in FIGURES}
    return {**kept, "is_success": success, "success": success}
