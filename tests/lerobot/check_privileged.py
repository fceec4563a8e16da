"""Policies that are told the truth: exported without pictures, trained, evaluated."""

import json
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from check_training import (
    CHUNK,
    EPISODES,
    STATE_AND_ACTION,
    checkpoint,
    exported,
    run,
    small_act,
    work,
)
from small_recipe import TASKS

import lemma
from lemma.core.errors import InvalidConfigError, LemmaError
from lemma.env.observation import truth_names
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.control.interfaces import ControlInput

ENV_STATE = "observation.environment_state"
NAMES = truth_names(("robot_0", "robot_1"))


@cache
def export() -> Path:
    """Return a data set of numbers alone."""
    options = "--no-images --environment-state privileged"
    return exported(options, work() / "numbers")


@cache
def oracle() -> Path:
    """Return a policy that was trained on it for a few steps."""
    options = [word for word in small_act("oracle") if "dataset.root" not in word]
    run("lerobot-train", *options, f"--dataset.root={export()}")
    return work() / "oracle/checkpoints/last/pretrained_model"


def test_it_holds_the_truth_by_name_and_no_pictures() -> None:
    info = json.loads((export() / "meta/info.json").read_text())
    assert info["features"][ENV_STATE]["names"] == NAMES
    assert not any("images" in name for name in info["features"])
    assert not (export() / "videos").exists()
    module = import_module("lerobot.datasets.lerobot_dataset")
    frames = module.LeRobotDataset("lemma/numbers", root=export())
    assert frames.meta.total_episodes == len(TASKS)
    assert frames[0][ENV_STATE].shape == (len(NAMES),)


def test_lerobot_eval_tells_it_too() -> None:
    run(
        "lerobot-eval",
        f"--policy.path={oracle()}",
        "--policy.device=cpu",
        "--env.type=lemma",
        f"--env.task={','.join(TASKS)}",
        "--env.environment_state=privileged",
        "--env.horizon_s=1.5",
        f"--eval.n_episodes={EPISODES}",
        f"--eval.batch_size={EPISODES}",
        "--output_dir=told",
    )
    found = json.loads((work() / "told/eval_info.json").read_text())
    assert found["overall"]["n_episodes"] == EPISODES * len(TASKS)


def test_its_result_says_that_it_is_an_oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Rollout, "horizon_s", 2.0)
    found = lemma.evaluate(
        f"lerobot-privileged:{oracle()}", tasks="stack", split="val", episodes=1
    )
    assert not found.errors
    assert found.result.about["oracle"]
    assert len(found.result.about["weights"]["act"]["sha256"]) == 64
    (row,) = found.rows
    assert (row["control"]["actions"], row["control"]["asked"]) == (20, 20 / CHUNK)


def test_nobody_is_told_the_truth_under_the_other_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Rollout, "horizon_s", 1.0)
    for name, told in (
        (f"lerobot:{oracle()}", "lerobot-privileged:"),
        (f"lerobot-privileged:{checkpoint()}", f"{len(NAMES)}"),
    ):
        with pytest.raises(LemmaError, match=told):
            lemma.evaluate(name, tasks="stack", split="val", episodes=1)


def test_what_has_eyes_as_well_is_refused() -> None:
    module = import_module("lemma.policies.control.lerobot")
    shapes = STATE_AND_ACTION | {ENV_STATE: (len(NAMES),)}
    eyes = {"observation.images.robot_0": (3, 48, 64)}
    options = {
        seen: {
            name: SimpleNamespace(shape=shape)
            for name, shape in {**shapes, **(eyes if seen else {})}.items()
        }
        for seen in (False, True)
    }
    config = SimpleNamespace(input_features=options[False], output_features={})
    told = module.control_options(config, 10.0, privileged=True)
    assert told["observation"] == "privileged"
    assert "cameras" not in told
    config.input_features = options[True]
    with pytest.raises(InvalidConfigError, match="not privileged"):
        module.control_options(config, 10.0, privileged=True)


def test_it_acts_on_what_environments_observe() -> None:
    module = import_module("lemma.policies.control.lerobot")
    policy = module.PrivilegedLeRobotPolicy(str(oracle()))
    env = lemma.make("pass", split="val", level="control", **policy.control_options)
    observation, _ = env.reset()
    other = {**observation, "goal": 1 - observation["goal"]}
    given = [
        ControlInput(instruction="", robots=("a", "b"), observation=seen)
        for seen in (observation, other)
    ]
    before, after = policy.act(given)
    assert np.asarray(before.rows).shape == (CHUNK, 2, 7)
    assert not np.allclose(before.rows, after.rows, atol=1e-6)
