"""Where a policy's decisions come from: the weights of its parts, by hash and seed."""

from importlib import import_module
from typing import Any

from lemma.core.errors import DatasetError
from lemma.policies.specification import ORACLE, PolicySpec

Weights = dict[str, dict[str, Any]]
"""By name of the model: hash, seed of the training, digest of its data."""


def learned_parts(policy: str) -> list[str]:
    """Return the parts of a policy's name that mean weights of ours."""
    # A colon is in addresses and in names of classes.
    parts = policy.split("+")
    return [part for part in parts if part != ORACLE and ":" not in part]


def weights_of(spec: PolicySpec) -> Weights:
    """Return the weights that a policy uses; none for oracles and others' policies.

    Raises:
        LemmaError: They are missing or damaged.
    """
    found: Weights = {}
    for part in learned_parts(spec.name):
        # torch is an extra, which the oracle and other people's policies do without.
        path = import_module("lemma.policies.weights").find_weights(part)
        about = import_module("lemma.policies.checkpoints").read_about(path)
        found[about.model] = {
            "sha256": import_module("lemma.dataset.files").sha256_of(path),
            "seed": about.training.get("seed", 0),
            "data": about.data,
        }
    return found


def training_seed(weights: Weights) -> int:
    """Return the seed that a policy was trained with; 0 without weights.

    Raises:
        DatasetError: Its parts were trained with different seeds.
    """
    seeds = {entry["seed"] for entry in weights.values()}
    if len(seeds) > 1:
        told = ", ".join(f"{name}: {entry['seed']}" for name, entry in weights.items())
        raise DatasetError(
            f"The parts of the policy were trained with different seeds ({told}), so "
            "its result belongs to none of them. Take parts of the same seed."
        )
    return int(seeds.pop()) if seeds else 0
