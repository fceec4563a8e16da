"""Harnesses count by seeds and take success at any step; they get what they need."""

from typing import Any

import gymnasium
import pytest

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.env.learning.flat_view import FlatView
from lemma.env.learning.harness_episodes import FIGURES, HarnessEpisodes
from lemma.tasks.instance import SPLITS


def episodes(first_seed: int = 0, **options: Any) -> HarnessEpisodes:
    return HarnessEpisodes(
        lemma.make("stack", split="test", control="joint_position", **options),
        first_seed,
    )


def begun(env: HarnessEpisodes, **how: Any) -> str:
    found: str = env.reset(**how)[1]["instance"]
    return found


def test_seeds_are_instances_of_the_split_in_order() -> None:
    env, count = episodes(first_seed=1000), SPLITS["test"]
    names = [begun(env, seed=seed) for seed in (1000, 1001, 1000 + count)]
    assert names == [f"v3/stack/test/{index}" for index in (0, 1, 0)]
    assert begun(env) == "v3/stack/test/1"
    assert begun(env, seed=3, options={"index": 5}) == "v3/stack/test/5"
    assert begun(env, options={"of_a_harness": True}) == "v3/stack/test/2"
    assert begun(env, options={"split": "val"}) == "v3/stack/val/3"


def test_success_is_said_at_the_end_alone() -> None:
    """Else whoever takes any success takes a tower that falls for one."""
    env = episodes(horizon_s=0.2, control_hz=10.0)

    class Solved(gymnasium.Wrapper[Any, Any, Any, Any]):
        def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
            *rest, info = super().step(action)
            return (*rest, {**info, "is_success": True, "success": True})

    env.env = Solved(env.env)
    observation, info = env.reset(seed=0)
    assert set(info) == set(FIGURES)
    held = observation["agent_pos"].reshape(2, 7)
    said = []
    for _ in range(2):
        *_, truncated, info = env.step(held)
        said.append((truncated, info["is_success"], info["success"]))
    assert said == [(False, False, False), (True, True, True)]


def test_flat_views_see_through_it() -> None:
    env = FlatView(episodes())
    assert env.reset(seed=0)[1]["instance"] == "v3/stack/test/0"
    assert env.get_wrapper_attr("_max_episode_steps") > 0
    assert env.get_wrapper_attr("task_description").startswith("Place")


def test_other_environments_are_refused() -> None:
    other: Any = gymnasium.Env()
    with pytest.raises(InvalidConfigError, match=r"lemma\.make"):
        HarnessEpisodes(other)
