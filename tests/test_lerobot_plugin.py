"""The plugin names what this package names; `make test-lerobot` runs it in lerobot."""

import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from packaging.requirements import Requirement

from lemma.core.errors import UnknownNameError
from lemma.dataset.lerobot.frames import Style, features
from lemma.env.camera_rig import close_cameras
from lemma.env.config import EnvConfig
from lemma.env.learning.motor_state import MOTOR_CONTROLS
from lemma.env.observation import truth_names
from lemma.tasks.language.vector import sentence_vector
from lemma.tasks.names import SUITE
from lemma.tasks.suite import load_instance

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "integrations/lerobot_env_lemma"
TEAM = ("robot_0", "robot_1")
SMALL = {"width": 48, "height": 32}


class Registry:
    """The base of the plugin's configuration, without lerobot's fields."""

    @staticmethod
    def register_subclass(name: str) -> Callable[[type], type]:
        assert name == "lemma"
        return lambda cls: cls


@dataclass
class PolicyFeature:
    type: str
    shape: tuple[int, ...]


STAND_INS: dict[str, dict[str, Any]] = {
    "lerobot": {},
    "lerobot.configs": {
        "FeatureType": SimpleNamespace(
            ACTION="action", STATE="state", VISUAL="image", ENV="env"
        ),
        "PolicyFeature": PolicyFeature,
    },
    "lerobot.envs": {},
    "lerobot.envs.configs": {"EnvConfig": Registry},
    "lerobot.envs.utils": {
        "_LazyAsyncVectorEnv": list,
        "freeze_after_episode_end": lambda maker: maker,
    },
    "lerobot.utils": {},
    "lerobot.utils.constants": {
        "ACTION": "action",
        "OBS_ENV_STATE": "observation.environment_state",
        "OBS_IMAGES": "observation.images",
        "OBS_STATE": "observation.state",
    },
}


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    for name, holds in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update(holds)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(FOLDER))
    yield import_module(FOLDER.name)
    del sys.modules[FOLDER.name]


def test_it_is_found_by_its_name_and_goes_with_the_lerobot_that_exports() -> None:
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]
    assert project["name"] == FOLDER.name
    assert FOLDER.name.startswith("lerobot_env_")
    assert (FOLDER / f"{FOLDER.name}.py").exists()
    ours = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (exports,) = map(Requirement, ours["optional-dependencies"]["lerobot"])
    needs = {need.name: need for need in map(Requirement, project["dependencies"])}
    assert needs["lerobot"].specifier == exports.specifier
    assert ours["name"] in needs


def test_what_is_observed_and_commanded_is_what_data_sets_hold(plugin: Any) -> None:
    cameras = ("robot_1", "overview")
    for options, style in (
        ({}, Style(depth=False)),
        (
            {**SMALL, "cameras": ",".join(cameras)},
            Style(width_px=48, height_px=32, depth=False, cameras=cameras),
        ),
        (
            {"environment_state": "sentence"},
            Style(depth=False, environment_state="sentence"),
        ),
        (
            {"environment_state": "privileged"},
            Style(depth=False, images=False, environment_state="privileged"),
        ),
    ):
        config = plugin.LemmaEnvConfig(**options)
        held = {
            name: feature["shape"]
            for name, feature in features(TEAM, style).items()
            if name.startswith(("observation.", "action"))
        }
        named = {config.features_map[name]: it for name, it in config.features.items()}
        assert {name: it.shape for name, it in named.items()} == held
    assert plugin.LemmaEnvConfig().fps == Style().fps


def test_options_are_those_of_an_environment_and_have_its_defaults(plugin: Any) -> None:
    usual = EnvConfig(task="pass", observation="rgb").at_control_level()
    options = plugin.LemmaEnvConfig().gym_kwargs
    assert set(options) <= {field.name for field in fields(EnvConfig)}
    for name in ("instruction", "width", "height", "horizon_s", "cameras"):
        assert options[name] == getattr(usual, name)


@pytest.mark.render
def test_a_sentence_is_observed_as_numbers(plugin: Any) -> None:
    config = plugin.LemmaEnvConfig(task="pass", environment_state="sentence", **SMALL)
    env = config.create_envs(n_envs=1)["pass"][0]
    observation, _ = env.reset(seed=[plugin.FIRST_SEED])
    said = sentence_vector(load_instance("pass", "test", 0).instructions["high_level"])
    assert np.array_equal(observation["environment_state"], said[None])
    env.close()


def test_an_oracle_observes_the_truth_instead_of_pictures(plugin: Any) -> None:
    config = plugin.LemmaEnvConfig(task="pass", environment_state="privileged", **SMALL)
    env = config.create_envs(n_envs=1)["pass"][0]
    observation, _ = env.reset(seed=[plugin.FIRST_SEED])
    assert set(observation) == {"agent_pos", "environment_state"}
    names = truth_names(TEAM)
    (told,) = observation["environment_state"]
    pairs = {name for name, value in zip(names, told, strict=True) if value == 1.0}
    for top, bottom in load_instance("pass", "test", 0).goal.pairs:
        assert f"{top}.on.{bottom}" in pairs
    env.close()
    with pytest.raises(UnknownNameError, match="sentence"):
        plugin.LemmaEnvConfig(environment_state="all of it")


@pytest.mark.parametrize("control", MOTOR_CONTROLS)
def test_states_and_actions_are_those_of_a_data_set(plugin: Any, control: str) -> None:
    config = plugin.LemmaEnvConfig(
        task="pass", environment_state="privileged", control=control, **SMALL
    )
    env = config.create_envs(n_envs=1)["pass"][0]
    observation, _ = env.reset(seed=[plugin.FIRST_SEED])
    held = features(TEAM, Style(control=control))["observation.state"]
    assert list(env.envs[0].env.state_names) == held["names"]
    shape = (1, *held["shape"])
    assert observation["agent_pos"].shape == env.action_space.shape == shape
    # A robot that is commanded to its measured positions stays where it is.
    moved, *_ = env.step(observation["agent_pos"])
    assert np.abs(moved["agent_pos"] - observation["agent_pos"]).max() < 2e-3
    env.close()
    with pytest.raises(UnknownNameError, match="joint_position"):
        plugin.LemmaEnvConfig(control="by thought")


@pytest.mark.render
def test_vectors_are_made_of_each_task(plugin: Any) -> None:
    config = plugin.LemmaEnvConfig(task="pass, hook", **SMALL)
    made = config.create_envs(n_envs=1)
    assert list(made) == ["pass", "hook"]
    env = made["hook"][0]
    observation, info = env.reset(seed=[plugin.FIRST_SEED + 2])
    assert info["instance"][0] == "v3/hook/test/2"
    assert observation["agent_pos"].shape == env.action_space.shape == (1, 14)
    shapes = {name: image.shape for name, image in observation["pixels"].items()}
    assert shapes == dict.fromkeys(close_cameras(TEAM), (1, 32, 48, 3))
    # Every network overshoots: what is out of bounds is clipped.
    assert np.isfinite(env.step(np.full((1, 14), 99.0, np.float32))[1])
    view = env.envs[0].env
    held = features(TEAM, Style())["observation.state"]["names"]
    assert list(view.state_names) == held
    assert tuple(plugin.LemmaEnvConfig().create_envs(1)) == SUITE
    lazy = config.create_envs(n_envs=2, use_async_envs=True)["hook"][0]
    assert len(lazy) == 2
    env.close()
