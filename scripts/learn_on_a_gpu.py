"""Train PPO to reach, to lift or to place in thousands of worlds at once.

python scripts/learn_on_a_gpu.py [TASK] [MINUTES] [WORLDS] [WEIGHTS.pt] [SEED]

The robot that reaches the object acts; its hand points down and moves in Cartesian
steps. The actor is saved. This command executes it on the CPU:

lemma evaluate --policy lemma.policies.control.hand_steps:HandPolicy \
    --policy-args weights=WEIGHTS.pt --level control --tasks lift --out out/lift

Needs: pip install "lemma-bench[warp]" torch
"""

import sys
import time

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import COLUMNS, able, features, network
from lemma.warp.vector_env import GpuVecEnv

STEPS, EPOCHS, BATCHES = 24, 5, 16
GAMMA, LAMBDA, CLIP, ENTROPY, RATE = 0.98, 0.95, 0.2, 0.001, 7e-4
LOG_STD = -0.7
HORIZON_S = {"reach": 8.0, "lift": 8.0}
"""Length of episodes by rung [s]; other rungs have 12 s."""
NEAR_AT_FIRST, NEAR_AT_LAST = 0.8, 0.08
"""Share of episodes that begin with a hand near a grasp, except for reach; it decreases
with success."""


class Learner:
    """Plain PPO with a Gaussian policy."""

    def __init__(self, env: GpuVecEnv, seed: int = 0) -> None:
        """Create actor and critic; the seed is for both and for the worlds."""
        torch.manual_seed(seed)
        self.env, device = env, env.device
        self.actor, self.critic = network().to(device), network(out=1).to(device)
        with torch.no_grad():
            next(iter(self.actor[-1].parameters())).mul_(0.01)
        self.log_std = torch.full((len(COLUMNS),), LOG_STD, device=device)
        self.log_std.requires_grad_(True)
        self.weights = [
            *self.actor.parameters(), *self.critic.parameters(), self.log_std
        ]  # fmt: skip
        self.optimizer = torch.optim.Adam(self.weights, RATE)
        self.x, self.robot = self.seen(env.reset(seed=seed)[0])

    def seen(self, observation: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the features of the acting robots, and their numbers, (n,)."""
        n = len(observation["here"])
        goal = observation["goal_state"].view(n, -1, 13)
        names = ("target", "here", "base", "asked")
        found = features(goal, *(observation[name] for name in names))
        robot = able(goal, self.env.arms)
        return found[torch.arange(n, device=robot.device), robot], robot

    def policy(self, x: Tensor) -> torch.distributions.Normal:
        """Return the distribution of actions."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())

    @torch.no_grad()
    def collect(self) -> tuple[list[Tensor], float, int]:
        """Act; return the batch, the success rate, and the number of episodes."""
        env, kept = self.env, []
        solved, ended = self.x.new_zeros(()), self.x.new_zeros(())
        tables = torch.arange(env.num_envs, device=env.device)
        for _ in range(STEPS):
            chosen = self.policy(self.x)
            action = chosen.sample()
            rows = action.new_zeros(env.num_envs, len(env.robots), len(COLUMNS))
            rows[tables, self.robot] = action
            after, reward, terminated, truncated, info = env.step(rows.flatten(1))
            value = self.critic(self.x)[:, 0]
            last, _ = self.seen(info["final_obs"])
            ahead = self.critic(last)[:, 0] * ~terminated
            done = terminated | truncated
            log_p = chosen.log_prob(action).sum(1)
            kept.append((self.x, action, log_p, value, reward, ahead, done))
            solved = solved + info["success"].sum()
            ended = ended + done.sum()
            self.x, self.robot = self.seen(after)
        gains, gain = [], torch.zeros_like(value)
        for _, _, _, value, reward, ahead, done in reversed(kept):
            gain = reward + GAMMA * ahead - value + GAMMA * LAMBDA * gain * ~done
            gains.append(gain)
        gains.reverse()
        columns = [torch.cat([row[i] for row in kept]) for i in range(4)]
        count = int(ended)
        return [*columns, torch.cat(gains)], float(solved) / max(1, count), count

    def learn(self, batch: list[Tensor]) -> None:
        """Update actor and critic."""
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
                    self.log_std.clamp_(-2.0, 0.0)


if __name__ == "__main__":
    defaults = ("reach_varied", "3", "4096", "hand.pt", "0")
    arguments = sys.argv[1:]
    task, minutes, worlds, path, seed = (*arguments, *defaults[len(arguments) :])
    rung = task.split("_")[0]
    first = 0.0 if rung == "reach" else NEAR_AT_FIRST
    env = GpuVecEnv(
        task, int(worlds), reward="rise", horizon_s=HORIZON_S.get(rung, 12.0),
        near=first, pool=min(512, 16 * int(worlds)), seed=int(seed),
    )  # fmt: skip
    learner = Learner(env, int(seed))
    start, rounds, steps, rate = time.perf_counter(), 0, 0, 0.0
    while (spent := time.perf_counter() - start) < 60.0 * float(minutes):
        batch, found, ended = learner.collect()
        learner.learn(batch)
        rounds, steps = rounds + 1, steps + len(batch[0])
        # An average, because only short episodes end at first.
        rate += 0.05 * (found - rate)
        if first:
            env.near = max(NEAR_AT_LAST, min(env.near, (1.0 - rate) * first))
        if rounds % 10 == 1:
            std = learner.log_std.detach().exp().mean()
            print(
                f"{steps} steps, {spent:.0f} s: {found:.0%} of {ended} succeeded, "
                f"potential {float(env.potential.mean()):.2f}, near {env.near:.2f}, "
                f"std {float(std):.2f}, lost {int(env.lost_worlds)}",
                flush=True,
            )
            torch.save(learner.actor.state_dict(), path)
    torch.save(learner.actor.state_dict(), path)
    print(f"{steps / spent:,.0f} steps/s with learning; {path}")
