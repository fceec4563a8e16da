"""PPO learns to reach for a cube; lifting is imitated first, and PPO goes on; a test.

python examples/09_learn_by_reward.py [TASK] [STEPS] [EPISODES] [CURVE.png]

TASK is a rung of the ladder on which robot 0 acts: reach_fixed or lift_fixed, or the
same with more variation. PPO learns reach from nothing. To lift, its policy first
imitates a script of ten lines (behavior cloning), and PPO goes on. Prints the
learning curve, and for each degree of variation the success in the first EPISODES
instances of the split test, judged as ``lemma evaluate`` judges. Needs
Stable-Baselines3: pip install "lemma-bench[rl]".
"""

import sys
import time
from functools import partial
from typing import Any

import gymnasium
import matplotlib as mpl
import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import lemma
from lemma.env.signals.goal_state import NUMBERS
from lemma.tasks.names import DEGREES, rung_task

UNITS = (1.0, 1.0, 1.0, 1.0, 0.1, 1.0, *[0.3] * 3, 0.5, *[0.3] * 3)
"""Divisors of the numbers of a goal state."""
NEAR_M = 0.05
"""Ways as long as this are told apart well [m]."""
SLOW_M, SLOWEST = 0.1, 0.2
"""To lift, steps become shorter within so much of the cube [m], down to this share."""
STEP_M, TURN_RAD = 0.08, 0.5
"""Longest step [m, rad]."""
DEMONSTRATIONS, CLONING_STEPS = 100, 15
"""Episodes of the script that are imitated, and steps of gradient descent for each."""


class Hand(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Robot 0 moves its hand forward, left, up, turns it, and closes its fingers."""

    def __init__(self, task: str, split: str = "train", horizon_s: float = 8.0) -> None:
        """Define the spaces: five numbers in [-1, 1], and the state of the hand."""
        self.lemma = lemma.make(
            task, split=split, observation="goal_state", control="delta_ee_pose",
            control_hz=5, delta_position_m=STEP_M, delta_rotation_rad=TURN_RAD,
            clip_actions=True, reward="dense", reward_discount=1.0,
            horizon_s=horizon_s,
        )  # fmt: skip
        super().__init__(self.lemma)
        self.lifts = task.startswith("lift")
        self.action_space = Box(-1.0, 1.0, (5,))
        self.observation_space = Box(-np.inf, np.inf, (len(NUMBERS) + 6,))

    def look(self, observation: dict[str, Any]) -> NDArray[np.float32]:
        """Return the state of the hand, and its ways once more, magnified nearby."""
        x, y = observation["tcp_pose"][:2] - observation["base_pose"][:2]
        self.forward = np.array([x, y]) / np.hypot(x, y)
        self.state = state = observation["goal_state"][: len(NUMBERS)]
        ways = [NUMBERS.index("object_forward"), NUMBERS.index("place_forward")]
        near = [np.tanh(state[way : way + 3] / NEAR_M) for way in ways]
        return np.concatenate([state / np.array(UNITS, np.float32), *near])

    def step_m(self) -> float:
        """Return how long a step can be; a fast hand knocks the cube away."""
        if not self.lifts:
            return STEP_M
        at = NUMBERS.index("object_forward")
        share = float(np.linalg.norm(self.state[at : at + 3])) / SLOW_M
        return STEP_M * min(max(share, SLOWEST), 1.0)

    def script(self) -> NDArray[np.float64]:
        """Return a good action for lifting, from the numbers of the state alone."""
        now = dict(zip(NUMBERS, self.state.tolist(), strict=True))
        forward, left, up = (now[f"object_{way}"] for way in ("forward", "left", "up"))
        beside, holds = np.hypot(forward, left), now["holds"]
        closes = holds or (beside < 0.01 and abs(up) < 0.008)
        # From above, so that the fingers come down on both sides of the cube.
        up = 0.05 if holds else up + 0.1 if beside > 0.03 else up
        way = np.array([forward, left, up]) / self.step_m()
        turn = now["object_turn"] / TURN_RAD
        return np.clip([*way, turn, -1.0 if closes else 1.0], -1.0, 1.0)

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Set the table."""
        observation, info = self.env.reset(**options)
        return self.look(observation), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move one hand; the other robots stay where they are."""
        forward, left, up, turn, grip = np.clip(action, -1.0, 1.0)
        rows = np.zeros(self.lemma.action_layout.shape)
        ahead, aside = self.forward, np.array([-self.forward[1], self.forward[0]])
        rows[0, :2] = forward * ahead + left * aside
        if self.lifts:
            grip = 1.0 if grip > 0.0 else -1.0
        rows[0, 2], rows[0, 5:] = up, (turn, grip)
        rows[0, :3] *= self.step_m() / STEP_M
        observation, reward, terminated, truncated, info = self.lemma.step(rows)
        # The end of its time counts, so it is no truncation: the return is then how far
        # the hand has come, and a policy that stays where it is earns nothing.
        over = terminated or truncated
        return self.look(observation), 4.0 * reward, over, False, info


class Curve(BaseCallback):
    """Prints and keeps how many of the last 100 episodes succeeded."""

    def __init__(self, every: int) -> None:
        """Keep how many steps lie between two points."""
        super().__init__()
        self.every, self.began_s = every, time.process_time()
        self.points: list[tuple[int, float]] = []

    def _on_step(self) -> bool:
        found = self.model.ep_success_buffer
        if self.num_timesteps // self.every > len(self.points) and found:
            rate, seconds = float(np.mean(found)), time.process_time() - self.began_s
            self.points.append((self.num_timesteps, rate))
            spent = f"{self.num_timesteps} steps, {seconds:.0f} s of processor time"
            print(f"{spent}: {rate:.0%}", flush=True)
        return True

    def draw(self, path: str, title: str) -> None:
        """Write a picture of the curve."""
        mpl.use("Agg")
        from matplotlib import pyplot as plt  # noqa: PLC0415

        figure, axes = plt.subplots(figsize=(5.0, 3.0))
        axes.plot(*zip(*self.points, strict=True))
        axes.set(xlabel="environment steps", ylabel="success", ylim=(0.0, 1.0))
        axes.set_title(title)
        figure.savefig(path, dpi=100, bbox_inches="tight")


def imitate(model: PPO, env: Hand, episodes: int) -> None:
    """Let the mean of a policy imitate the script, also after disturbed actions."""
    rng, seen, done = np.random.default_rng(0), [], []
    for _ in range(episodes):
        observation, _ = env.reset()
        over = False
        while not over:
            seen.append(observation)
            done.append(env.script())
            disturbed = done[-1] + rng.normal(0.0, 0.2, 5)
            observation, _, over, _, _ = env.step(disturbed)
    x = torch.tensor(np.array(seen), dtype=torch.float32)
    y = torch.tensor(np.array(done), dtype=torch.float32)
    optimizer = torch.optim.Adam(model.policy.parameters(), 1e-3)
    for _ in range(CLONING_STEPS * episodes):
        batch = torch.randint(len(x), (256,))
        mean = model.policy.get_distribution(x[batch]).mode()
        loss = torch.nn.functional.mse_loss(mean, y[batch])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def test(model: PPO, task: str, episodes: int) -> float:
    """Return the share of test instances that a policy solves in 100 s each."""
    env, solved = Hand(task, "test", 100.0), 0
    for index in range(episodes):
        observation, info = env.reset(options={"index": index})
        done = False
        while not done:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, done, _, info = env.step(action)
        solved += bool(info["is_success"])
    return solved / episodes


if __name__ == "__main__":
    defaults = ("reach_fixed", "45000", "60", "")
    given = sys.argv[1:]
    task, steps, episodes, curve = (*given, *defaults[len(given) :])
    torch.set_num_threads(1)
    lifts = task.startswith("lift")
    model = PPO(
        "MlpPolicy",
        make_vec_env(partial(Hand, task), n_envs=4, seed=0),
        n_steps=256 if lifts else 128,
        batch_size=256 if lifts else 128,
        learning_rate=3e-4 if lifts else 1e-3,
        gamma=0.97,
        policy_kwargs={"log_std_init": -1.5 if lifts else -0.5},
        seed=0,
        device="cpu",
    )
    if lifts:
        hand = Hand(task)
        hand.reset(seed=0)
        imitate(model, hand, min(DEMONSTRATIONS, int(steps) // 100))
        share = test(model, task, int(episodes))
        print(f"{task}, test, imitation alone: {share:.1%}", flush=True)
    points = Curve(every=min(int(steps), 4096))
    model.learn(int(steps), callback=points)
    print(f"{time.process_time():.0f} s of processor time")
    for degree in DEGREES:
        name = rung_task(task.split("_")[0], degree)
        share = test(model, name, int(episodes))
        print(f"{name}, test: {share:.1%} of {episodes}", flush=True)
    if curve:
        points.draw(curve, task)
