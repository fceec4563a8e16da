"""Train MAPPO of skrl, with one agent per robot and a central critic.

python scripts/learn_with_skrl.py [TASK] [STEPS] [WORLDS]

Needs: pip install "lemma-bench[warp]" torch skrl
"""

import sys
from dataclasses import fields
from typing import Any

import torch
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.multi_agents.torch import ExperimentCfg
from skrl.multi_agents.torch.mappo import MAPPO, MAPPO_CFG
from skrl.trainers.torch import SequentialTrainer
from torch import Tensor

import lemma
from lemma.warp.learners import RobotsEnv

ROLLOUT = 24


def layers(numbers: int, out: int) -> torch.nn.Sequential:
    """Return a small network."""
    return torch.nn.Sequential(
        torch.nn.Linear(numbers, 128), torch.nn.ELU(),
        torch.nn.Linear(128, 128), torch.nn.ELU(),
        torch.nn.Linear(128, out),
    )  # fmt: skip


class Actor(GaussianMixin, Model):
    """A Gaussian policy from a robot's observation to its action."""

    def __init__(self, **spaces: Any) -> None:
        """Create the network."""
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = layers(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.full((self.num_actions,), -0.5))

    def compute(self, inputs: dict[str, Tensor], role: str) -> tuple[Tensor, Any]:
        """Return means and log standard deviations."""
        del role
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """Estimates the value of the state of all robots."""

    def __init__(self, **spaces: Any) -> None:
        """Create the network."""
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = layers(self.num_states, 1)

    def compute(self, inputs: dict[str, Tensor], role: str) -> tuple[Tensor, Any]:
        """Return the value."""
        del role
        return self.net(inputs["states"]), {}


def configuration(names: list[str]) -> MAPPO_CFG:
    """Return the settings of the learner."""
    # skrl 2.1 rejects its own defaults of these: it reads {} as settings by agent.
    keywords = [f.name for f in fields(MAPPO_CFG) if f.name.endswith("_kwargs")]
    return MAPPO_CFG(
        rollouts=ROLLOUT,
        learning_epochs=4,
        mini_batches=4,
        discount_factor=0.98,
        learning_rate=5e-4,
        experiment=ExperimentCfg(write_interval=0, checkpoint_interval=0),
        **{key: {name: {} for name in names} for key in keywords},
    )


def train(task: str, steps: int, worlds: int, **options: Any) -> RobotsEnv:
    """Train for some control steps, and return the environment."""
    inner = RobotsEnv(lemma.make_gpu_vec(task, worlds, reward="level", **options))
    env = wrap_env(inner, "isaaclab-multi-agent", verbose=False)
    names = env.possible_agents
    models, memories = {}, {}
    for name in names:
        spaces = {
            "observation_space": env.observation_spaces[name],
            "state_space": env.state_spaces[name],
            "action_space": env.action_spaces[name],
            "device": env.device,
        }
        models[name] = {"policy": Actor(**spaces), "value": Critic(**spaces)}
        memories[name] = RandomMemory(
            memory_size=ROLLOUT, num_envs=env.num_envs, device=env.device
        )
    agent = MAPPO(
        possible_agents=names,
        models=models,
        memories=memories,
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        device=env.device,
        cfg=configuration(names),
    )
    trainer = SequentialTrainer(
        env=env,
        agents=agent,
        cfg={
            "timesteps": steps,
            "headless": True,
            "disable_progressbar": True,
            "close_environment_at_exit": False,
        },
    )
    trainer.train()
    return inner


if __name__ == "__main__":
    defaults = ("reach_varied", "2400", "4096")
    arguments = sys.argv[1:]
    task, steps, worlds = (*arguments, *defaults[len(arguments) :])
    played = train(task, int(steps), int(worlds), horizon_s=8.0)
    potential = float(played.env.potential.mean())
    print(f"{task}: mean potential {potential:.2f} after {steps} steps")
