"""PPO learns to reach or to lift on thousands of tables at once.

python scripts/learn_on_a_gpu.py [TASK] [MINUTES] [WORLDS] [WEIGHTS.pt]

Robot 0 acts; its hand points down and is moved step by step. The actor is saved, and
played on the CPU by

lemma evaluate --policy lemma.policies.control.hand_steps:HandPolicy \
    --policy-args weights=WEIGHTS.pt --level control --tasks reach --out out/reach

Needs: pip install "lemma-bench[warp]" torch
"""

import sys
import time

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import COLUMNS, features, network
from lemma.warp.vector_env import GpuVecEnv

STEPS, EPOCHS, BATCHES = 24, 4, 4
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.98, 0.95, 0.2, 0.003, 5e-4
HORIZON_S = 8.0
NEAR_AT_FIRST = 0.7
"""To lift, so many episodes begin with the hand near the cube; later fewer."""


def seen(observation: dict[str, Tensor]) -> Tensor:
    """Return the features of robot 0."""
    goal = observation["goal_state"].view(len(observation["here"]), -1, 13)
    parts = (goal, *(observation[key] for key in ("target", "here", "base")))
    return features(*(part[:, :1] for part in parts))[:, 0]


class Learner:
    """Plain PPO with a Gaussian policy."""

    def __init__(self, env: GpuVecEnv) -> None:
        """Make networks of actor and critic."""
        self.env, device = env, env.device
        self.actor, self.critic = network().to(device), network(out=1).to(device)
        with torch.no_grad():
            next(iter(self.actor[-1].parameters())).mul_(0.01)
        self.log_std = torch.full((len(COLUMNS),), -0.5, device=device)
        self.log_std.requires_grad_(True)
        self.weights = [
            *self.actor.parameters(), *self.critic.parameters(), self.log_std
        ]  # fmt: skip
        self.optimizer = torch.optim.Adam(self.weights, RATE)
        self.x = seen(env.reset(seed=0)[0])

    def policy(self, x: Tensor) -> torch.distributions.Normal:
        """Return the distribution of actions."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())

    @torch.no_grad()
    def collect(self) -> tuple[list[Tensor], float, int]:
        """Act; return what is learned from, the share of successes, and episodes."""
        env, kept, solved, ended = (
            self.env,
            [],
            self.x.new_zeros(()),
            self.x.new_zeros(()),
        )
        for _ in range(STEPS):
            chosen = self.policy(self.x)
            action = chosen.sample()
            rows = action.new_zeros(env.num_envs, env.numbers)
            rows[:, : len(COLUMNS)] = action
            after, reward, terminated, truncated, info = env.step(rows)
            value = self.critic(self.x)[:, 0]
            ahead = self.critic(seen(info["final_obs"]))[:, 0] * ~terminated
            done = terminated | truncated
            log_p = chosen.log_prob(action).sum(1)
            kept.append((self.x, action, log_p, value, reward, ahead, done))
            solved = solved + info["success"].sum()
            ended = ended + done.sum()
            self.x = seen(after)
        gains, gain = [], torch.zeros_like(value)
        for _, _, _, value, reward, ahead, done in reversed(kept):
            gain = reward + GAMMA * ahead - value + GAMMA * LAMBDA * gain * ~done
            gains.append(gain)
        gains.reverse()
        columns = [torch.cat([row[i] for row in kept]) for i in range(4)]
        count = int(ended)
        return [*columns, torch.cat(gains)], float(solved) / max(1, count), count

    def learn(self, batch: list[Tensor]) -> None:
        """Improve actor and critic."""
        x, action, old, value, gain = batch
        target = gain + value
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        for _ in range(EPOCHS):
            for part in torch.randperm(len(x), device=x.device).chunk(BATCHES):
                chosen = self.policy(x[part])
                ratio = (chosen.log_prob(action[part]).sum(1) - old[part]).exp()
                bounded = ratio.clamp(1 - CLIP, 1 + CLIP)
                loss = -torch.min(ratio * gain[part], bounded * gain[part]).mean()
                error = self.critic(x[part])[:, 0] - target[part]
                loss = loss + error.square().mean()
                loss = loss - ENTROPY * chosen.entropy().sum(1).mean()
                self.optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.weights, 1.0)
                self.optimizer.step()
                with torch.no_grad():
                    self.log_std.clamp_(-2.5, 0.0)


if __name__ == "__main__":
    defaults = ("reach_varied", "3", "4096", "hand.pt")
    given = sys.argv[1:]
    task, minutes, worlds, path = (*given, *defaults[len(given) :])
    lifts = task.startswith("lift")
    env = GpuVecEnv(
        task, int(worlds), reward="level", reward_discount=GAMMA,
        horizon_s=HORIZON_S, near=NEAR_AT_FIRST if lifts else 0.0,
        pool=min(512, 16 * int(worlds)),
    )  # fmt: skip
    learner = Learner(env)
    start, rounds, steps = time.perf_counter(), 0, 0
    while (spent := time.perf_counter() - start) < 60.0 * float(minutes):
        batch, rate, ended = learner.collect()
        learner.learn(batch)
        rounds, steps = rounds + 1, steps + len(batch[0])
        env.near = min(env.near, max(0.1, 1.0 - rate) * NEAR_AT_FIRST)
        if rounds % 10 == 1:
            std = learner.log_std.detach().exp().mean()
            print(
                f"{steps} steps, {spent:.0f} s: {rate:.0%} of {ended} succeeded, "
                f"potential {float(env.potential.mean()):.2f}, std {float(std):.2f}, "
                f"lost {int(env.lost_worlds)}",
                flush=True,
            )
            torch.save(learner.actor.state_dict(), path)
    torch.save(learner.actor.state_dict(), path)
    print(f"{steps / spent:,.0f} steps/s with learning; {path}")
