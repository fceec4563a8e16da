"""Recipes of the documentation for policies that read text: `make test-lerobot`.

No published weights are needed: configurations stand in for them.
"""

import re
import shlex
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import metadata
from typing import Any
from unittest.mock import patch

import pytest
import torch
from check_training import ROOT, exported, work
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig, parser
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies import factory
from small_recipe import TASKS, recipe

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.dataset.lerobot.frames import Style
from lemma.env.learning.motor_state import WAYPOINT, motor_names
from lemma.policies.control.lerobot import TEAM, LeRobotPolicy, control_options

BASES = {"smolvla": "lerobot/smolvla_base", "pi0": "lerobot/pi0_base"}
RESOLUTION = {"smolvla": "resize_imgs_with_padding", "pi0": "image_resolution"}
STATE, ACTION, IMAGES = "observation.state", "action", "observation.images."


@cache
def section() -> str:
    page = (ROOT / "docs/lerobot.md").read_text()
    return re.split(r"\n##+ ", page.split("### Policies that read text\n")[1])[0]


def commands(program: str) -> list[list[str]]:
    """Return the words after a program's name in each of its calls in the section."""
    lines = section().replace("\\\n", " ").splitlines()
    calls = [shlex.split(line) for line in lines if line.startswith(f"    {program} ")]
    return [words[len(program.split()) :] for words in calls]


def option(words: list[str], name: str) -> str:
    """Return the value of ``--name value`` or ``--name=value``."""
    (found,) = (
        word.removeprefix(f"--{name}=") if "=" in word else words[place + 1]
        for place, word in enumerate(words)
        if word.split("=")[0] == f"--{name}"
    )
    return found


@cache
def dataset() -> Any:
    """Return the data set that the documented command makes, of one episode."""
    ((_, *words),) = commands("lemma render")
    place = words.index("--out")
    more = [*words[:place], *words[place + 2 :], "--tasks", TASKS[0]]
    folder = exported(" ".join(more), work() / "read")
    return LeRobotDataset("lemma/read", root=folder, video_backend="pyav")


def training(name: str) -> list[str]:
    """Return the options of the documented training."""
    (found,) = (
        words
        for words in commands("lerobot-train")
        if option(words, "policy.path") == BASES[name]
    )
    return found


@cache
def base(name: str) -> str:
    """Write a configuration like that of the published weights; return its folder."""
    seen = {f"{IMAGES}camera{i}": (3, 256, 256) for i in (1, 2, 3)}
    config = PreTrainedConfig.get_choice_class(name)(
        input_features={
            STATE: PolicyFeature(FeatureType.STATE, (6,)),
            **{key: PolicyFeature(FeatureType.VISUAL, it) for key, it in seen.items()},
        },
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
    )
    folder = work() / f"base-{name}"
    config.save_pretrained(folder)
    return str(folder)


class Untrained(torch.nn.Module):
    """Stands in for the network of a policy, which would need the weights."""

    @classmethod
    def from_pretrained(cls, **_: Any) -> "Untrained":
        return cls()


def configured(
    name: str, change: Callable[[list[str]], list[str]] = lambda words: words
) -> Any:
    """Return the configuration that ``lerobot-train`` makes of documented options."""

    @parser.wrap()
    def parse(config: TrainPipelineConfig) -> TrainPipelineConfig:
        config.validate()
        return config

    path = f"--policy.path={BASES[name]}"
    words = [
        f"--policy.path={base(name)}" if word == path else word
        for word in change(training(name))
    ]
    with patch.object(sys, "argv", ["lerobot-train", *words]):
        policy = parse().policy
    with patch.object(factory, "get_policy_class", lambda _: Untrained):
        factory.make_policy(policy, ds_meta=dataset().meta)
    policy.validate_features()
    return policy


@pytest.mark.parametrize("name", BASES)
def test_documented_options_take_the_features_of_the_data_set(name: str) -> None:
    config = configured(name)
    cameras = option(commands("lemma render")[0], "cameras").split(",")
    width, height = map(int, option(commands("lemma render")[0], "size").split("x"))
    images = {key: it.shape for key, it in config.image_features.items()}
    assert images == {IMAGES + camera: (3, height, width) for camera in cameras}
    # The order that the page tells of.
    assert list(images) == [IMAGES + camera for camera in sorted(cameras)]
    assert config.robot_state_feature.shape == config.action_feature.shape == (14,)
    waypoints = len(motor_names(WAYPOINT, TEAM))
    assert max(14, waypoints) <= min(config.max_state_dim, config.max_action_dim)
    assert set(config.input_features) == {STATE, *images}
    found = control_options(config, 10.0)
    assert found["cameras"] == tuple(sorted(cameras))
    assert (found["width"], found["height"]) == (width, height)
    assert config.n_action_steps == 10
    default = (Style.height_px, Style.width_px)
    ours = {"smolvla": (height, width), "pi0": default}[name]
    assert getattr(config, RESOLUTION[name]) == ours


@pytest.mark.parametrize("name", BASES)
def test_other_names_of_cameras_are_refused(name: str) -> None:
    def kept(words: list[str]) -> list[str]:
        return [word for word in words if "input_features" not in word]

    with pytest.raises(ValueError, match="Feature mismatch"):
        configured(name, kept)
    empty = configured(name, lambda words: [*words, "--policy.empty_cameras=1"])
    with pytest.raises(InvalidConfigError, match="empty_camera_0"):
        control_options(empty, 10.0)


def test_every_frame_has_the_instruction_as_text() -> None:
    record = lemma.load(recipe()).find(TASKS[0], "train", 0)
    starts = [row["dataset_from_index"] for row in dataset().meta.episodes]
    told = [dataset()[start]["task"] for start in starts]
    assert told[0] == record.high_level
    assert len(set(told)) == len(told) == 2


@pytest.mark.parametrize(("column", "name"), enumerate(BASES, 1))
def test_the_table_has_lerobots_defaults(column: int, name: str) -> None:
    config = PreTrainedConfig.get_choice_class(name)(device="cpu")
    rows = [line.split("|")[1:-1] for line in section().splitlines() if line[:1] == "|"]
    checked = 0
    for row in rows[2:]:
        fields = re.findall(r"`(\w+)`", row[0])
        values: list[str] = []
        for field in fields:
            if field in RESOLUTION.values() and field != RESOLUTION[name]:
                continue
            value = getattr(config, field)
            many = value.values() if isinstance(value, dict) else value
            many = [many] if isinstance(many, int) else many
            values += [str(getattr(each, "value", each)) for each in many]
            checked += 1
        assert re.findall(r"\d+|[A-Z_]{3,}", row[column]) == values
    assert checked == 7


def test_extras_and_checkpoints_have_the_documented_names() -> None:
    ((_, requirement),) = commands(".venv-lerobot/bin/pip")
    extras = set(re.findall(r"\[(.*)\]", requirement)[0].split(","))
    assert extras == {"smolvla", "pi"}
    assert extras <= set(metadata("lerobot").get_all("Provides-Extra") or ())
    (words,) = commands("lemma evaluate")
    made = option(training("smolvla"), "output_dir")
    last = f"{made}/checkpoints/last/pretrained_model"
    assert option(words, "policy") == f"lerobot:{last}"
    name, _ = option(words, "policy-args").split("=")
    assert name in LeRobotPolicy.__init__.__annotations__
