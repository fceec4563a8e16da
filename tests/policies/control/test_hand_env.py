"""A hand that is moved step by step: coming further pays, staying and hovering less."""

from collections.abc import Callable

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from tiers import slow_but

from lemma.core.poses import FloatArray
from lemma.env.signals.goal_state import NUMBERS
from lemma.env.signals.rewards import grip
from lemma.policies.control.hand_env import HandEnv
from lemma.policies.control.hand_steps import FEATURE_NAMES, UNITS

Policy = Callable[[dict[str, float]], list[float]]


def still(now: dict[str, float]) -> list[float]:
    return [0.0] * 5


def hover(now: dict[str, float]) -> list[float]:
    """Go 10 cm over where the cube is grasped, with open fingers, and stay."""
    up = (now["object_up"] + 0.1) / 0.03
    ways = (now["object_forward"] / 0.03, now["object_left"] / 0.03, up)
    return [*ways, now["object_turn"] / 0.25, 1.0]


def lift(now: dict[str, float]) -> list[float]:
    """Go over the cube, down around it, close, and rise: what PPO has to find."""
    aside = float(np.hypot(now["object_forward"], now["object_left"]))
    up, closes = now["object_up"], now["holds"] > 0.5
    closes |= aside < 0.01 and abs(up) < 0.01
    up = 0.05 if now["holds"] > 0.5 else up + 0.08 if aside > 0.02 else up
    ways = np.array([now["object_forward"], now["object_left"], up]) / 0.02
    return [*ways, now["object_turn"] / 0.4, -1.0 if closes else 1.0]


def play(env: HandEnv, policy: Policy, seed: int) -> tuple[float, bool]:
    """Return the return of an episode, and whether it succeeded."""
    seen, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        now = dict(zip(NUMBERS, seen[: len(NUMBERS)] * UNITS, strict=True))
        row = np.clip(policy(now), -1.0, 1.0)
        seen, reward, terminated, truncated, info = env.step(row)
        total, over = total + reward, terminated or truncated
    return total, bool(info["is_success"])


@pytest.mark.parametrize("task", slow_but(["lift_fixed", "lift"], "lift"))
def test_a_lift_pays_more_than_hovering_and_that_more_than_standing_still(
    task: str,
) -> None:
    env = HandEnv(task)
    (best, won), (over, no), (rest, _) = (
        play(env, policy, 0) for policy in (lift, hover, still)
    )
    assert won
    assert not no
    assert best > over + 1.0 > rest + 1.05
    assert rest == pytest.approx(0.0, abs=1e-6)


def test_starts_near_the_cube_are_states_from_which_it_is_lifted() -> None:
    env = HandEnv("lift_varied", near=1.0)
    for seed in range(4):
        total, won = play(env, lift, seed)
        assert won
        assert 1.0 < total < 2.0


@pytest.mark.filterwarnings("ignore:.*infinity")
def test_the_spaces_are_what_gymnasium_expects() -> None:
    env = HandEnv("lift_fixed", horizon_s=1.0)
    assert env.observation_space.shape == (len(FEATURE_NAMES),)
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("turn", [0.0, -0.5])
def test_the_way_to_a_grasp_pays_at_every_step(turn: float) -> None:
    """From afar, over the object, down around it with open fingers, then closed."""
    way: list[FloatArray | tuple[float, ...]] = [
        *((aside, 0.1, 1.0) for aside in (1.0, 0.5, 0.2, 0.1, 0.05)),
        *((0.02, 0.08, 1.0), (0.005, 0.04, 1.0), (0.0, 0.02, 1.0), (0.0, 0.0, 1.0)),
        *((0.0, 0.0, opening) for opening in (0.8, 0.6, 0.5)),
    ]
    found = [grip(aside, above, turn, opening) for aside, above, opening in way]
    assert np.all(np.diff(found) > 0.0)
    assert found[0] >= 0.0
    assert found[-1] == pytest.approx(1.0 - 0.105 * abs(turn))
    # Beside the cube, low, is no way to it; nor are closed fingers over it.
    assert grip(0.05, 0.0, turn, 1.0) < grip(0.05, 0.07, turn, 1.0)
    assert grip(0.0, 0.05, turn, 0.0) < grip(0.0, 0.05, turn, 1.0)
