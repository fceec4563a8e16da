"""Demonstrated actions through LeRobot's processors and back: `make test-lerobot`."""

import json
from collections.abc import Mapping
from typing import Any

import pytest
import torch
from check_train_policy import filmed, work
from check_training import dataset
from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.converters import (
    policy_action_to_transition,
    transition_to_policy_action,
)
from lerobot.utils.feature_utils import dataset_to_policy_features

from demonstration_film import Film
from lemma.dataset.lerobot.frames import PRIVILEGED
from train_lerobot_policy import POLICIES, make_policy

STATE, ACTION = "observation.state", "action"
CLOSE = 1e-6
"""Of the largest number of its kind."""


def outermost(actions: torch.Tensor) -> torch.Tensor:
    """Return all actions, and the two with every number at its least and greatest."""
    return torch.cat([actions, actions.amin(0)[None], actions.amax(0)[None]])


def normalized_by(before: Any, actions: torch.Tensor) -> torch.Tensor:
    """Return normalized actions; a pre-processor wants an observation, too."""
    found: torch.Tensor = before({ACTION: actions, STATE: torch.zeros_like(actions)})[
        ACTION
    ]
    return found


def check(actions: torch.Tensor, before: Any, after: Any, config: Any) -> None:
    """Check that normalized actions become the same again, and how large they are."""
    normalized = normalized_by(before, actions)
    assert not torch.allclose(normalized, actions, atol=0.1)
    error = (after(normalized) - actions).abs().amax(0)
    assert (error <= CLOSE * actions.abs().amax(0)).all(), error
    # A chunk, as a policy predicts it, is treated alike.
    chunk = after(normalized[None])
    assert torch.equal(chunk[0], after(normalized))
    if config.type == "diffusion":
        # Its scheduler clips predictions to this range.
        assert config.clip_sample
        most = normalized.abs().max()
        assert most <= config.clip_sample_range * (1.0 + CLOSE)
        assert most > 0.99 * config.clip_sample_range
    else:
        # Nothing is clipped at a standard deviation or two.
        assert normalized.abs().max() > 2.0


@pytest.mark.parametrize("policy", POLICIES)
def test_waypoints_come_back_as_they_were(policy: str) -> None:
    """With statistics and processors of train_lerobot_policy.py, saved and loaded."""
    seen = Film.load(filmed(PRIVILEGED), "cpu")
    learner, before, after = make_policy(policy, seen, "cpu")
    actions = outermost(seen.vectors[ACTION])
    check(actions, before, after, learner.config)
    folder = work() / f"round-trip-{policy}"
    after.save_pretrained(folder)
    loaded = PolicyProcessorPipeline.from_pretrained(
        folder,
        config_filename="policy_postprocessor.json",
        to_transition=policy_action_to_transition,
        to_output=transition_to_policy_action,
    )
    normalized = normalized_by(before, actions)
    assert torch.equal(loaded(normalized), after(normalized))


@pytest.mark.parametrize("policy", POLICIES)
def test_motor_commands_of_an_export_come_back_as_they_were(policy: str) -> None:
    """With statistics of ``lemma render``, which ``lerobot-train`` takes."""
    meta = dataset().meta
    features = dataset_to_policy_features(meta.features)
    config = PreTrainedConfig.get_choice_class(policy)(
        input_features={key: it for key, it in features.items() if key != ACTION},
        output_features={ACTION: features[ACTION]},
        device="cpu",
    )
    before, after = make_pre_post_processors(config, dataset_stats=meta.stats)
    rows = torch.stack(list(dataset().hf_dataset[ACTION]))
    check(outermost(rows), before, after, config)


def test_statistics_are_those_of_all_actions() -> None:
    """Those of an export are gathered episode by episode."""
    rows = torch.stack(list(dataset().hf_dataset[ACTION])).double()
    stats: Mapping[str, Any] = json.loads(
        (dataset().root / "meta/stats.json").read_text()
    )[ACTION]
    told = {name: torch.tensor(stats[name], dtype=torch.double) for name in stats}
    assert torch.allclose(told["mean"], rows.mean(0), atol=1e-6)
    assert (told["min"] <= rows.amin(0) + 1e-7).all()
    assert (told["max"] >= rows.amax(0) - 1e-7).all()
    std = rows.std(0, correction=0)
    wide = std > 0.01
    assert torch.allclose(told["std"][wide], std[wide], rtol=1e-4)
    assert torch.allclose(told["std"][~wide], torch.tensor(0.01).double())
