"""Flat views hold what the environment holds, under names that harnesses know."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from tiers import MODES, slow_but

import lemma
from lemma.core.errors import InvalidActionError, InvalidConfigError
from lemma.env.control.modes import CONTROLS
from lemma.env.learning.flat_view import STATES, FlatView
from lemma.robots.ur.build import JOINTS


def flat(state: tuple[str, ...] = ("agent_pos",), **options: Any) -> FlatView:
    made = gymnasium.make("lemma/Stack-v0", split="test", index=0, **options)
    return FlatView(made, state)


@pytest.mark.filterwarnings(
    "ignore:.*different from the unwrapped version",
    "ignore:.*recommend using a symmetric and normalized space",
)
@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_gymnasium_finds_no_fault_in_a_flat_view(control: str) -> None:
    env = flat(STATES, control=control, observation="privileged")
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("control", slow_but(CONTROLS, *MODES))
def test_a_row_of_numbers_does_what_the_rows_do(control: str) -> None:
    view, env = (
        flat(control=control),
        lemma.make("stack", split="test", index=0, control=control),
    )
    first, _ = view.reset()
    expected, _ = env.reset()
    assert np.array_equal(first["observation.state"], expected["agent_pos"])
    env.action_space.seed(0)
    for _ in range(3):
        action = env.action_space.sample()
        found = view.step(action.reshape(-1))
        expected, reward, *_ = env.step(action)
        assert np.array_equal(found[0]["observation.state"], expected["agent_pos"])
        assert found[1] == reward
    assert view.get_wrapper_attr("state_hash")() == env.state_hash()
    layout = env.action_layout
    assert view.action_names[0] == f"robot_0.{layout.columns[0]}"
    assert view.action_names[len(layout.columns)] == f"robot_1.{layout.columns[0]}"
    assert len(view.action_names) == view.action_space.shape[0]  # type: ignore[index]


def test_states_have_a_name_for_every_number() -> None:
    env = flat(STATES)
    found, _ = env.reset()
    assert len(env.state_names) == found["observation.state"].size == 56
    assert env.state_names[6:8] == ("robot_0.gripper", f"robot_1.{JOINTS[0]}")
    assert len(set(env.state_names)) == 56


@pytest.mark.render
def test_images_are_those_of_the_environment() -> None:
    options: dict[str, Any] = {"observation": "rgbd", "width": 48, "height": 32}
    cameras = ("robot_1", "overview", "robot_0_wrist")
    view = flat(cameras=cameras, **options)
    env = lemma.make("stack", split="test", index=0, cameras=cameras, **options)
    found, _ = view.reset()
    expected, _ = env.reset()
    for name in cameras:
        image = found[f"observation.images.{name}"]
        assert image.shape == (32, 48, 3)
        assert np.array_equal(image, expected["pixels"][name])
        depth_m = found[f"observation.depth.{name}"]
        assert np.array_equal(depth_m, expected["depth"][name])
    assert set(found) == set(view.observation_space)  # type: ignore[call-overload]


def test_the_truth_is_there_only_when_it_was_asked_for() -> None:
    assert set(flat().reset()[0]) == {"observation.state"}
    env = flat(observation="privileged")
    found, _ = env.reset()
    truth = found["observation.environment_state"]
    assert truth.shape == (11 * 7 + 11 + 2 * 4 + 11 * 11 + 4 * 2 * 7,)
    assert truth[:77].any()


def test_vectors_of_flat_views_can_be_made() -> None:
    envs = gymnasium.make_vec(
        "lemma/Stack-v0", num_envs=2, control="delta_ee_pose", wrappers=[FlatView]
    )
    observations, _ = envs.reset(seed=0)
    assert observations["observation.state"].shape == (2, 14)
    assert envs.action_space.shape == (2, 14)
    envs.step(envs.action_space.sample())
    envs.close()


@pytest.mark.parametrize(
    "bad", [np.zeros((2, 7)), np.zeros(13), "left", None, [[1.0], [1.0, 2.0]], 3.0]
)
def test_what_is_no_row_is_refused_with_what_is(bad: Any) -> None:
    env = flat(control="delta_ee_pose")
    env.reset()
    with pytest.raises(InvalidActionError, match=r"shape \(14,\), with robot_0\.dx"):
        env.step(bad)
    with pytest.raises(InvalidActionError, match="dy of robot_0 is nan"):
        env.step([0.0, np.nan, *[0.0] * 12])


def test_other_levels_and_states_are_refused() -> None:
    with pytest.raises(InvalidConfigError, match='level="control"'):
        FlatView(lemma.make("stack", level="skill"))
    for state in (("joints",), (), "agent_pos"):
        with pytest.raises(InvalidConfigError, match="agent_vel"):
            flat(state)  # type: ignore[arg-type]
