"""Learn a hand-over as a whole: clone demonstrations, then improve them with PPO.

python scripts/learn_a_team.py [TASK,...] [MINUTES] [WORLDS] [WEIGHTS.pt] [SEED]

One network moves both hands. It learns in thousands of worlds of all teams of the
tasks.
First it imitates the rules of lemma.policies.control.team_rules in the states that it
visits itself (DAgger), then PPO continues, with a term of imitation that fades out. The
cloned network is saved as WEIGHTS-cloned.pt. Prints a table: phase, steps, seconds,
successful share of the episodes that ended, their number, and more. This command
executes the network on the CPU:

lemma evaluate --policy lemma.policies.control.team_steps:TeamPolicy \
    --policy-args weights=WEIGHTS.pt --level control --tasks pass --out out/pass

Needs: pip install "lemma-bench[warp]" torch
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from lemma.policies.control.hand_steps import COLUMNS
from lemma.policies.control.team_rules import demonstrate
from lemma.policies.control.team_steps import Team, homes_of, team_network
from lemma.tasks.suite import TASKS
from lemma.warp.vector_env import GpuVecEnv

STEPS = 24
"""Control steps of each world in a round."""
HORIZON_S = 40.0
"""Length of an episode for each pair of the goal [s]."""
CLONE_SHARE = 0.85
"""Share of the time for imitation."""
HIDDEN = 512
"""Width of the actor's layers."""
CLONE_RATE, CLONE_BATCHES, CLONE_BATCH, KEPT_ROUNDS = 1e-3, 1024, 16384, 120
TAUGHT_ROUNDS, TAUGHT_LEAST, NOISE = 25, 0.3, 0.1
"""The share of worlds that the rules move falls by one over this number of rounds, to
the smallest share, so that episodes get ahead; standard deviation of the noise on
actions."""
GAMMA, LAMBDA, CLIP, RATE, EPOCHS, BATCHES = 0.995, 0.95, 0.2, 3e-4, 4, 16
LOG_STD, LOG_STD_RANGE, MOST_KL = -2.5, (-4.0, -1.5), 0.02
CRITIC_ROUNDS = 6
"""Rounds in which only the critic learns."""
IMITATION, IMITATION_SHARE = 1.0, 0.6
"""Weight of the squared distance to the rules at the beginning of PPO, and the share of
its time within which it falls to 0."""


@dataclass(eq=False)
class Table:
    """Worlds of one team, with their present state."""

    env: GpuVecEnv
    homes: Tensor
    team: Team

    @classmethod
    def of(cls, env: GpuVecEnv, seed: int) -> "Table":
        """Reset the worlds."""
        homes = homes_of([robot.arm.name for robot in env.robots]).to(env.device)
        return cls(env, homes, _team(env, homes, env.reset(seed=seed)[0]))

    def step(self, rows: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Team]:
        """Act; return reward, terminated, truncated, success and the last states."""
        after, reward, ended, late, info = self.env.step(rows.flatten(1))
        self.team = _team(self.env, self.homes, after)
        last = _team(self.env, self.homes, info["final_obs"])
        return reward, ended, late, info["success"], last


def _team(env: GpuVecEnv, homes: Tensor, observation: dict[str, Tensor]) -> Team:
    n = len(observation["here"])
    goal = observation["goal_state"].view(n, len(env.robots), -1)
    names = ("target", "here", "base", "asked")
    target, here, base, asked = (observation[name] for name in names)
    return Team(goal, target, here, base, asked, env.arms, homes)


class Counts:
    """Successful and ended episodes, counted on the device."""

    def __init__(self, device: torch.device) -> None:
        """Begin at 0."""
        self._solved, self._ended = (torch.zeros((), device=device) for _ in range(2))

    def add(self, success: Tensor, done: Tensor) -> None:
        """Count the worlds in two masks."""
        self._solved += success.sum()
        self._ended += done.sum()

    def found(self) -> tuple[float, int]:
        """Return the successful share of the episodes that ended, and their number."""
        ended = int(self._ended)
        return float(self._solved) / max(1, ended), ended


class Learner:
    """Actor and critic, which see both hands, and the worlds."""

    def __init__(self, envs: list[GpuVecEnv], seed: int = 0) -> None:
        """Create the networks; the seed is for both and for the worlds."""
        torch.manual_seed(seed)
        self.tables, device = [Table.of(env, seed) for env in envs], envs[0].device
        self.actor = team_network(HIDDEN).to(device)
        self.critic = team_network(out=1).to(device)
        self.log_std = torch.full((len(COLUMNS),), LOG_STD, device=device)
        self.log_std.requires_grad_(True)
        self.weights = [
            *self.actor.parameters(), *self.critic.parameters(), self.log_std
        ]  # fmt: skip
        self.kept: list[tuple[Tensor, Tensor]] = []
        self.rounds = self.steps = 0

    def policy(self, x: Tensor) -> torch.distributions.Normal:
        """Return the distribution of actions of hands."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())

    def value(self, x: Tensor) -> Tensor:
        """Return the values of states, the mean of those from both hands."""
        found: Tensor = self.critic(x)[..., 0].mean(-1)
        return found

    @torch.no_grad()
    def measure(self) -> float:
        """Play one episode in each world without noise; return the successful share."""
        won, count = torch.zeros((), device=self.log_std.device), 0
        for table in self.tables:
            table.team = _team(table.env, table.homes, table.env.reset()[0])
            fresh = torch.ones_like(table.team.asked[:, 0], dtype=torch.bool)
            config = table.env.config
            for _ in range(round(config.horizon_s * config.control_hz)):
                rows = self.actor(table.team.features())
                _, ended, late, success, _ = table.step(rows)
                won += (success & fresh).sum()
                fresh &= ~(ended | late)
            count += len(fresh)
        return float(won) / count

    def clone(self, optimizer: torch.optim.Optimizer) -> tuple[float, int, float]:
        """Imitate the rules in one more round of states; return success and error."""
        solved, count = self._visit()
        x, rows = (torch.cat(part) for part in zip(*self.kept, strict=True))
        error = torch.zeros((), device=x.device)
        for _ in range(CLONE_BATCHES):
            part = torch.randint(len(x), (CLONE_BATCH,), device=x.device)
            # A squared error would give most weight to the few large mistakes.
            loss = (self.actor(x[part]) - rows[part]).abs().mean()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.weights, 1.0)
            optimizer.step()
            error = error + loss.detach() / CLONE_BATCHES
        return solved, count, float(error)

    @torch.no_grad()
    def _visit(self) -> tuple[float, int]:
        """Collect states and the actions of the rules; return success and episodes."""
        taught = max(TAUGHT_LEAST, 1.0 - self.rounds / TAUGHT_ROUNDS)
        inputs, labels, counts = [], [], Counts(self.log_std.device)
        for table in self.tables:
            worlds = table.env.num_envs
            by_rules = torch.rand(worlds, 1, 1, device=table.env.device) < taught
            for _ in range(STEPS):
                x, rows = table.team.features(), demonstrate(table.team)
                inputs.append(x.flatten(0, 1))
                labels.append(rows.flatten(0, 1))
                rows = torch.where(by_rules, rows, self.actor(x))
                rows = rows + NOISE * torch.randn_like(rows)
                _, over, late, success, _ = table.step(rows)
                counts.add(success, over | late)
                self.steps += worlds
        self.kept.append((torch.cat(inputs), torch.cat(labels)))
        del self.kept[:-KEPT_ROUNDS]
        self.rounds += 1
        return counts.found()

    @torch.no_grad()
    def collect(self) -> tuple[list[Tensor], float, int]:
        """Act; return the batch, the success rate, and the number of episodes."""
        parts, counts = [], Counts(self.log_std.device)
        for table in self.tables:
            kept = []
            for _ in range(STEPS):
                x, wanted = table.team.features(), demonstrate(table.team)
                chosen = self.policy(x)
                rows = chosen.sample()
                reward, over, late, success, last = table.step(rows)
                ahead = self.value(last.features()) * ~over
                log_p, value = chosen.log_prob(rows).sum(-1), self.value(x)
                done = over | late
                kept.append((x, rows, log_p, value, wanted, reward, ahead, done))
                counts.add(success, done)
                self.steps += table.env.num_envs
            gains, gain = [], torch.zeros_like(kept[0][3])
            for *_, value, _, reward, ahead, done in reversed(kept):
                gain = reward + GAMMA * ahead - value + GAMMA * LAMBDA * gain * ~done
                gains.append(gain)
            columns = [torch.cat([row[i] for row in kept]) for i in range(5)]
            parts.append([*columns, torch.cat(gains[::-1])])
        self.rounds += 1
        batch = [torch.cat(part) for part in zip(*parts, strict=True)]
        return batch, *counts.found()

    def learn(
        self,
        batch: list[Tensor],
        optimizer: torch.optim.Optimizer,
        imitation: float,
        *,
        critic_only: bool,
    ) -> None:
        """Update the critic, and the actor unless told not to."""
        x, rows, old, value, wanted, gain = batch
        target = gain + value
        gain = ((gain - gain.mean()) / (gain.std() + 1e-8))[:, None]
        for _ in range(EPOCHS):
            moved = torch.zeros((), device=x.device)
            for part in torch.randperm(len(x), device=x.device).chunk(BATCHES):
                loss = (self.value(x[part]) - target[part]).square().mean()
                if not critic_only:
                    chosen = self.policy(x[part])
                    change = chosen.log_prob(rows[part]).sum(-1) - old[part]
                    # Each hand has its own ratio, and both have the team's gain.
                    ratio, ours = change.exp(), gain[part]
                    bounded = ratio.clamp(1 - CLIP, 1 + CLIP)
                    loss = loss - torch.min(ratio * ours, bounded * ours).mean()
                    away = (chosen.mean - wanted[part]).square().mean()
                    loss = loss + imitation * away
                    moved = moved + (ratio - 1 - change).mean().detach() / BATCHES
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.weights, 1.0)
                optimizer.step()
                with torch.no_grad():
                    self.log_std.clamp_(*LOG_STD_RANGE)
            if float(moved) > MOST_KL:
                break


def _tell(learner: Learner, phase: str, start: float, *numbers: object) -> None:
    spent = time.perf_counter() - start
    lost = sum(int(table.env.lost_worlds) for table in learner.tables)
    row = (phase, learner.steps, f"{spent:.0f}", *numbers, lost)
    print(*row, sep="\t", flush=True)


def _save(network: torch.nn.Module, path: Path) -> None:
    """Save a network in 16 bits, so that its file is half as large."""
    torch.save({n: w.half().cpu() for n, w in network.state_dict().items()}, path)


def train(learner: Learner, minutes: float, path: Path) -> None:
    """Clone, measure, improve, measure; save both networks."""
    start, budget = time.perf_counter(), 60.0 * minutes
    columns = ("phase", "steps", "seconds", "success", "episodes", "error or std")
    print(*columns, "lost", sep="\t")
    fused = learner.log_std.is_cuda
    optimizer = torch.optim.Adam(learner.actor.parameters(), CLONE_RATE, fused=fused)
    while (spent := time.perf_counter() - start) < CLONE_SHARE * budget or (
        not learner.rounds
    ):
        share = spent / max(1.0, CLONE_SHARE * budget)
        optimizer.param_groups[0]["lr"] = CLONE_RATE * max(0.1, 1.0 - share)
        rate, ended, error = learner.clone(optimizer)
        _tell(learner, "clone", start, f"{rate:.4f}", ended, f"{error:.5f}")
    learner.kept.clear()
    _save(learner.actor, path.with_name(f"{path.stem}-cloned.pt"))
    _tell(learner, "cloned", start, f"{learner.measure():.4f}", "all", "-")
    optimizer = torch.optim.Adam(learner.weights, RATE, fused=fused)
    begin, first = time.perf_counter(), learner.rounds
    left = start + budget - begin
    while time.perf_counter() - begin < left or learner.rounds == first:
        spent = (time.perf_counter() - begin) / max(1.0, left)
        imitation = IMITATION * max(0.0, 1.0 - spent / IMITATION_SHARE)
        only = learner.rounds - first < CRITIC_ROUNDS
        batch, rate, ended = learner.collect()
        learner.learn(batch, optimizer, imitation, critic_only=only)
        std = float(learner.log_std.detach().exp().mean())
        _tell(learner, "ppo", start, f"{rate:.4f}", ended, f"{std:.3f}")
        _save(learner.actor, path)
    _tell(learner, "learned", start, f"{learner.measure():.4f}", "all", "-")


def main(
    task: str = "pass",
    minutes: str = "7",
    worlds: str = "4096",
    path: str = "team.pt",
    seed: str = "0",
) -> None:
    """Train in worlds of all teams of the tasks."""
    tables = [(name, team) for name in task.split(",") for team in TASKS[name].teams]
    each = max(1, int(worlds) // len(tables))
    envs = [
        GpuVecEnv(
            name,
            each,
            team=team,
            reward="rise",
            horizon_s=HORIZON_S * (2 if name.endswith("2") else 1),
            pool=min(512, 16 * each),
            # Instances of different seeds differ.
            seed=1000 * int(seed),
        )
        for name, team in tables
    ]
    # Enough for regression, and several times as fast.
    torch.set_float32_matmul_precision("high")
    train(Learner(envs, int(seed)), float(minutes), Path(path))


if __name__ == "__main__":
    main(*sys.argv[1:])
