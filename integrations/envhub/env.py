"""LEMMA Bench for EnvHub: the code of a repository on the Hub.

It needs ``pip install lemma-bench lerobot_env_lemma``.
"""

from typing import Any

from lerobot_env_lemma import LemmaEnvConfig


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, Any]]:
    """Return a vector of environments for each task: ``{task: {0: vector}}``.

    Args:
        n_envs: Number of environments in a vector.
        use_async_envs: Whether each environment has its own process.
        cfg: A configuration; of one that is not LEMMA's, only the tasks are used.
    """
    if not isinstance(cfg, LemmaEnvConfig):
        cfg = LemmaEnvConfig(task=getattr(cfg, "task", None))
    return cfg.create_envs(n_envs, use_async_envs)
