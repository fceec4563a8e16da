"""Train PPO of rsl_rl, with all robots of a world as one agent.

python scripts/learn_with_rsl_rl.py [TASK] [ITERATIONS] [WORLDS] [FOLDER]

Needs: pip install "lemma-bench[warp]" torch rsl-rl-lib
"""

import sys
from typing import Any

from rsl_rl.runners import OnPolicyRunner

import lemma
from lemma.warp.learners import RunnerEnv

ROLLOUT = 24


def configuration() -> dict[str, Any]:
    """Return the settings of the runner."""
    net = {"class_name": "MLPModel", "hidden_dims": [128, 128], "activation": "elu"}
    spread = {"class_name": "GaussianDistribution", "init_std": 0.6}
    return {
        "num_steps_per_env": ROLLOUT,
        "save_interval": 100,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**net, "obs_normalization": True, "distribution_cfg": spread},
        "critic": {**net, "obs_normalization": True},
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 4,
            "num_mini_batches": 4,
            "gamma": 0.98,
            "lam": 0.95,
            "learning_rate": 5e-4,
            "schedule": "adaptive",
            "entropy_coef": 0.003,
        },
    }


def train(
    task: str, iterations: int, worlds: int, folder: str | None, **options: Any
) -> RunnerEnv:
    """Train for some iterations of 24 steps, and return the environment."""
    env = RunnerEnv(lemma.make_gpu_vec(task, worlds, reward="level", **options))
    runner = OnPolicyRunner(env, configuration(), folder, env.device)
    runner.learn(iterations, init_at_random_ep_len=True)
    return env


if __name__ == "__main__":
    defaults = ("reach_varied", "100", "4096", "out/rsl_rl")
    arguments = sys.argv[1:]
    task, iterations, worlds, folder = (*arguments, *defaults[len(arguments) :])
    played = train(task, int(iterations), int(worlds), folder, horizon_s=8.0)
    potential = float(played.env.potential.mean())
    print(f"{task}: mean potential {potential:.2f} after {iterations} iterations")
