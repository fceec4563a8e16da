"""Learn to reach for a cube by PPO on a CPU, from dense rewards, and print the curve.

python examples/09_learn_a_sub_goal.py [STEPS]

Needs Stable-Baselines3: pip install "lemma-bench[rl]".
"""

import sys
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import lemma


class Reach(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The arm that is nearest to a cube brings its hand within 4 cm of it, in 6 s."""

    def __init__(self) -> None:
        """Define the spaces: steps of one hand, and where the cube is from it."""
        self.lemma = lemma.make(
            "pass", control="delta_ee_pose", control_hz=5, delta_position_m=0.08,
            clip_actions=True, reward="dense", reward_discount=1.0, horizon_s=6.0,
        )  # fmt: skip
        super().__init__(self.lemma)
        self.action_space = Box(-1.0, 1.0, (3,))
        self.observation_space = Box(-5.0, 5.0, (3,))

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Choose the cube of the goal, and the arm."""
        _, info = self.env.reset(**options)
        self.cube = self.lemma.instance.goal.pairs[0][0]
        arms = list(self.lemma.episode.simulation.arms.values())
        x, y = info["state"][self.cube][:2]
        bases = [arm.robot.placement.base.xy for arm in arms]
        self.row = int(np.argmin([np.hypot(x - bx, y - by) for bx, by in bases]))
        self.arm = arms[self.row]
        return self.offset(info), info

    def offset(self, info: dict[str, Any]) -> Any:
        """Return the way from the hand to the cube [m]."""
        offset = info["state"][self.cube][:3] - self.arm.tcp_pose()[:3, 3]
        return offset.astype(np.float32)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move one hand; grippers stay open, and hands as they are turned."""
        rows = np.zeros((2, 7))
        rows[:, 6] = 1.0
        rows[self.row, :3] = action
        _, reward, terminated, truncated, info = self.lemma.step(rows)
        offset = self.offset(info)
        reached = bool(np.linalg.norm(offset) < 0.04)
        info["is_success"] = reached
        # The end of its time counts, so it is no truncation.
        done = reached or terminated or truncated
        return offset, 10.0 * reward + 5.0 * reached, done, False, info


class Curve(BaseCallback):
    """Prints how many of the last 100 episodes reached the cube."""

    def __init__(self, every: int) -> None:
        """Keep how many steps lie between two lines."""
        super().__init__()
        self.every = every

    def _on_step(self) -> bool:
        found = self.model.ep_success_buffer
        if self.num_timesteps % self.every == 0 and found:
            rate = np.mean(found)
            print(f"{self.num_timesteps} steps: reached {rate:.0%}", flush=True)
        return True


if __name__ == "__main__":
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 30_000
    model = PPO(
        "MlpPolicy",
        make_vec_env(Reach, n_envs=4, seed=0),
        n_steps=128,
        batch_size=128,
        learning_rate=1e-3,
        gamma=0.97,
        gae_lambda=0.9,
        policy_kwargs={"log_std_init": -0.5},
        seed=0,
        device="cpu",
    )
    model.learn(steps, callback=Curve(every=min(steps, 2048)))
