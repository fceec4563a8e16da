"""One call measures the same as views and arms do."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict

from lemma.core.poses import Pose
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv


@pytest.mark.parametrize("index", [0, 3])
def test_joints_openings_and_tools_are_those_of_views_and_arms(index: int) -> None:
    env = ControlEnv(EnvConfig(task="stack", split="test", index=index))
    env.reset()
    rng = np.random.default_rng(index)
    layout, spaces = env.action_layout, env.observation_space
    assert isinstance(spaces, Dict)
    for _ in range(40):
        found, *_ = env.step(rng.uniform(layout.low, layout.high, layout.shape))
        simulation = env.episode.simulation
        view = env._observer.view(simulation.scene)
        poses: list[float] = []
        for arm in simulation.arms.values():
            pose = Pose.from_matrix(arm.tcp_pose())
            poses += [*pose.position, *pose.quaternion]
        assert view.joint_velocities is not None
        assert view.opening_m_s is not None
        for name, plain in {
            "agent_pos": np.c_[view.joints, view.opening_m],
            "agent_vel": np.c_[view.joint_velocities, view.opening_m_s],
            "tcp_pose": np.array(poses),
        }.items():
            box = spaces[name]
            assert isinstance(box, Box)
            expected = np.clip(plain.ravel().astype(np.float32), box.low, box.high)
            np.testing.assert_array_equal(found[name], expected)
            assert found[name].dtype == np.float32
