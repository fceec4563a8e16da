"""Train PPO to hold a hand over a cube, or to pick it up, and test it.

python examples/09_learn_by_reward.py [TASK] [STEPS] [EPISODES] [CURVE.png] [WEIGHTS.pt]

TASK is a rung of the ladder that one robot can do: reach_varied or lift_varied, or the
same with less or more variation. It prints the learning curve, and for each degree of
variation the success rate on the first EPISODES instances of the split test, by the
rules of ``lemma evaluate``. This command plays WEIGHTS.pt:

lemma evaluate --policy lemma.policies.control.hand_steps:HandPolicy \
    --policy-args weights=WEIGHTS.pt --level control --tasks lift --out out/lift

Needs Stable-Baselines3: pip install "lemma-bench[rl]".
"""

import sys
import time
from collections import deque
from functools import partial

import matplotlib as mpl
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from lemma.policies.control.hand_env import HandEnv
from lemma.tasks.names import DEGREES, rung_task

NEAR_AT_FIRST, NEAR_AT_LAST = 0.8, 0.08
"""For lift, the share of episodes that begin with the hand near a grasp: over the cube,
around it or closed on it. It decreases with success."""
HORIZON_S = 8.0
"""Length of an episode in training [s]."""


class Curve(BaseCallback):
    """Prints and records the success rate of the last 100 episodes, by their start."""

    def __init__(self, every: int, near: float) -> None:
        """Store the number of steps between points, and the initial share near."""
        super().__init__()
        self.every, self.near, self.most = every, near, near
        self.began_s = time.process_time()
        self.recent: deque[bool] = deque(maxlen=100)
        self.points: list[tuple[int, float, float]] = []

    def _on_step(self) -> bool:
        for done, info in zip(self.locals["dones"], self.locals["infos"], strict=True):
            if done:
                self.recent.append(bool(info["is_success"]))
        if self.num_timesteps // self.every > len(self.points) and self.recent:
            rate, seconds = self.rate(), time.process_time() - self.began_s
            self.points.append((self.num_timesteps, rate, self.near))
            spent = f"{self.num_timesteps} steps, {seconds:.0f} s of processor time"
            print(f"{spent}: {rate:.0%}, {self.near:.0%} begin near", flush=True)
        return True

    def rate(self) -> float:
        """Return the success rate of recent episodes."""
        return float(np.mean(self.recent))

    def _on_rollout_end(self) -> None:
        if self.near and len(self.recent) >= 50:
            fewer = (1.0 - self.rate()) * self.most
            self.near = max(NEAR_AT_LAST, min(self.near, fewer))
            self.training_env.env_method("set_wrapper_attr", "near", self.near)

    def draw(self, path: str, title: str) -> None:
        """Write a plot of the curve."""
        mpl.use("Agg")
        from matplotlib import pyplot as plt  # noqa: PLC0415

        figure, axes = plt.subplots(figsize=(5.0, 3.0))
        steps, rates, near = zip(*self.points, strict=True)
        axes.plot(steps, rates, label="succeeded")
        if self.most:
            axes.plot(steps, near, linestyle=":", label="began near a grasp")
            axes.legend()
        axes.set(xlabel="environment steps", ylabel="episodes", ylim=(0.0, 1.0))
        axes.set_title(title)
        figure.savefig(path, dpi=100, bbox_inches="tight")


def test(model: PPO, task: str, episodes: int) -> float:
    """Return the success rate on test instances, with 100 s for each."""
    env, solved = HandEnv(task, "test", horizon_s=100.0), 0
    for index in range(episodes):
        observation, info = env.reset(options={"index": index})
        done = False
        while not done:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        solved += bool(info["is_success"])
    return solved / episodes


def weights(model: PPO) -> dict[str, torch.Tensor]:
    """Return the actor's layers in the format of HandPolicy."""
    policy = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    return {
        f"{k}.{name}": value.detach().clone()
        for k, layer in enumerate(layers)
        for name, value in layer.state_dict().items()
    }


if __name__ == "__main__":
    defaults = ("lift_varied", "130000", "60", "", "")
    arguments = sys.argv[1:]
    task, steps, episodes, curve, path = (*arguments, *defaults[len(arguments) :])
    torch.set_num_threads(1)
    near = 0.0 if task.startswith("reach") else NEAR_AT_FIRST
    one = partial(HandEnv, task, horizon_s=HORIZON_S, near=near)
    model = PPO(
        "MlpPolicy",
        make_vec_env(one, n_envs=4, seed=0),
        n_steps=256,
        batch_size=128,
        learning_rate=7e-4,
        gamma=0.98,
        policy_kwargs={
            "log_std_init": -0.7,
            "net_arch": {"pi": [128, 128], "vf": [128, 128]},
            "activation_fn": torch.nn.ELU,
        },
        seed=0,
        device="cpu",
    )
    torch.set_num_threads(1)
    points = Curve(min(int(steps), 4096), near)
    model.learn(int(steps), callback=points)
    print(f"{time.process_time():.0f} s of processor time")
    if path:
        torch.save(weights(model), path)
    if curve:
        points.draw(curve, task)
    for degree in DEGREES if int(episodes) else ():
        name = rung_task(task.split("_")[0], degree)
        share = test(model, name, int(episodes))
        print(f"{name}, test: {share:.1%} of {episodes}", flush=True)
