"""The expert's motion as joint positions."""

import gymnasium
import pytest

import lemma
from lemma.core.errors import InvalidConfigError


@pytest.mark.slow
def test_the_three_line_loop_solves_an_instance_at_control_level() -> None:
    env = gymnasium.make(
        "lemma/Pass-v0", control="joint_position", split="val", control_hz=25.0
    )
    expert = lemma.ExpertPolicy(env)
    for index in (0, 1):
        observation, _ = env.reset(options={"index": index})
        done = False
        while not done:
            observation, _, done, truncated, info = env.step(expert.act(observation))
            assert not truncated
        assert info["is_success"]


def test_other_control_modes_are_refused_with_the_one_that_is_not() -> None:
    env = gymnasium.make("lemma/Pass-v0", control="ee_pose")
    with pytest.raises(InvalidConfigError, match='control="joint_position"'):
        lemma.ExpertPolicy(env)
