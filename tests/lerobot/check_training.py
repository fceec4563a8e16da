"""lerobot trains on an export and evaluates what it trained: `make test-lerobot`."""

import json
import math
import os
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_recipe import TASKS, recipe

import lemma
from lemma.cli.main import main
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.control.interfaces import ControlInput, chunk_of
from lemma.tasks.language.vector import NUMBERS, sentence_vector

WIDTH, HEIGHT = 64, 48
ROOT = Path(__file__).parents[2]
KINDS = ("high_level", "human")
EVALUATED = ("pass", "stack", "poke", "hook")
STEPS, CHUNK = 4, 10
CAMERAS = "robot_0,robot_1"
EPISODES = 2
"""Of each task, evaluated."""
EXPECTED = (
    "Using CPU, this will be slow",
    "No job name provided",
    # The decoder of lerobot if FFmpeg is not installed.
    "torchcodec",
    "Auto-detected device",
    "device='cuda' is not available",
)
"""Warnings that say nothing of this package."""


def run(program: str, *options: str) -> str:
    """Run a command of lerobot; return what it printed, which warns of nothing."""
    quiet = {"HF_HUB_OFFLINE": "1", "TQDM_DISABLE": "1"}
    done = subprocess.run(
        [str(Path(sys.executable).with_name(program)), *options],
        env={**os.environ, **quiet},
        capture_output=True,
        text=True,
        check=False,
        cwd=work(),
    )
    told = done.stdout + done.stderr
    assert done.returncode == 0, told[-4000:]
    warnings = [
        line
        for line in told.splitlines()
        if re.search(r"\bWARN|Warning\b|^ERROR", line)
        and not any(known in line for known in EXPECTED)
    ]
    assert not warnings, warnings
    return told


@cache
def work() -> Path:
    return Path(mkdtemp(prefix="lemma-lerobot-"))


@cache
def export() -> Path:
    """Return a data set for training: small pictures, each episode in two kinds."""
    return exported(
        f"--size {WIDTH}x{HEIGHT} --cameras {CAMERAS} "
        "--instructions high-level,human "
        "--environment-state sentence",
        work() / "set",
    )


def exported(options: str, out: Path) -> Path:
    """Export the training episodes of the small recipe, without depth."""
    words = f"render {recipe()} --form lerobot --split train --no-depth --workers 1"
    with pytest.raises(SystemExit) as end:
        main([*words.split(), *options.split(), "--out", str(out)])
    assert end.value.code == 0
    return out


def small_act(out: str, loaders: int = 0) -> tuple[str, ...]:
    """Return the options of a training of a few steps."""
    return (
        "--dataset.repo_id=lemma/small",
        f"--dataset.root={export()}",
        "--dataset.video_backend=pyav",
        "--policy.type=act",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        "--policy.pretrained_backbone_weights=null",
        f"--policy.chunk_size={CHUNK}",
        f"--policy.n_action_steps={CHUNK}",
        "--policy.dim_model=64",
        "--policy.n_heads=2",
        "--policy.dim_feedforward=64",
        f"--steps={STEPS}",
        "--batch_size=2",
        f"--num_workers={loaders}",
        "--log_freq=1",
        f"--output_dir={out}",
    )


@cache
def checkpoint() -> Path:
    """Return a policy that lerobot trained for a few steps and saved."""
    told = run("lerobot-train", *small_act("trained"))
    losses = [float(loss) for loss in re.findall(r"\sloss:(\S+)", told)]
    assert len(losses) == STEPS
    assert all(map(math.isfinite, losses))
    return work() / "trained/checkpoints/last/pretrained_model"


@cache
def plugin() -> Any:
    """Return the plugin, found as lerobot finds it: by the name of its distribution."""
    import_module("lerobot.utils.import_utils").register_third_party_plugins()
    return sys.modules["lerobot_env_lemma"]


def dataset() -> Any:
    module = import_module("lerobot.datasets.lerobot_dataset")
    return module.LeRobotDataset("lemma/small", root=export(), video_backend="pyav")


def test_every_episode_is_there_in_both_kinds() -> None:
    told = json.loads((export() / "extras/episodes.json").read_text())["episodes"]
    names = [(one["task"], one["instruction"]) for one in told]
    assert names == list(product(TASKS, KINDS))
    frames = dataset()
    for one, row in zip(told, frames.meta.episodes, strict=True):
        first = frames[row["dataset_from_index"]]
        assert first["task"] == one["instructions"][one["instruction"]]
        assert row["length"] == one["length"]


def test_a_policy_is_trained_on_an_export_as_it_is() -> None:
    config = json.loads((checkpoint() / "config.json").read_text())
    images = [f"observation.images.robot_{robot}" for robot in range(2)]
    shapes = {
        name: feature["shape"]
        for part in ("input_features", "output_features")
        for name, feature in config[part].items()
    }
    assert shapes == {
        "observation.state": [14],
        "action": [14],
        "observation.environment_state": [NUMBERS],
        **{image: [3, HEIGHT, WIDTH] for image in images},
    }


def test_lerobot_eval_evaluates_what_was_trained() -> None:
    told = run(
        "lerobot-eval",
        f"--policy.path={checkpoint()}",
        "--policy.device=cpu",
        "--env.type=lemma",
        f"--env.task={','.join(EVALUATED)}",
        f"--env.cameras={CAMERAS}",
        f"--env.width={WIDTH}",
        f"--env.height={HEIGHT}",
        "--env.environment_state=sentence",
        "--env.horizon_s=1.5",
        f"--env.render_width={WIDTH}",
        f"--env.render_height={HEIGHT}",
        f"--eval.n_episodes={EPISODES}",
        f"--eval.batch_size={EPISODES}",
        "--output_dir=evaluated",
    )
    assert "End of eval" in told
    found = json.loads((work() / "evaluated/eval_info.json").read_text())
    assert tuple(found["per_group"]) == EVALUATED
    for group in (*found["per_group"].values(), found["overall"]):
        for figure in ("avg_sum_reward", "avg_max_reward", "pc_success"):
            assert math.isfinite(group[figure])
    assert found["overall"]["n_episodes"] == EPISODES * len(EVALUATED)
    for one in found["per_task"]:
        videos = one["metrics"]["video_paths"]
        assert len(one["metrics"]["successes"]) == len(videos) == EPISODES
        assert all((work() / video).stat().st_size for video in videos)


@pytest.mark.parametrize("task", TASKS)
def test_recorded_actions_solve_the_task_in_lerobots_environment(task: str) -> None:
    """States, pictures, actions and success mean the same on both sides."""
    config = plugin().LemmaEnvConfig(
        task=task, split="train", cameras=CAMERAS, width=WIDTH, height=HEIGHT
    )
    env = config.create_envs(n_envs=1)[task][0]
    observed, info = env.reset(
        seed=[plugin().FIRST_SEED], options={"lerobot_new_rollout": True}
    )
    record = lemma.load(recipe()).find(task, "train", 0)
    assert info["instance"][0] == record.key
    assert env.call("task_description") == (record.high_level,)
    frames = dataset()
    row = frames.meta.episodes[len(KINDS) * TASKS.index(task)]
    first = frames[row["dataset_from_index"]]
    assert np.allclose(observed["agent_pos"][0], first["observation.state"], atol=1e-6)
    for robot in ("robot_0", "robot_1"):
        theirs = first[f"observation.images.{robot}"].numpy().transpose(1, 2, 0)
        ours = observed["pixels"][robot][0] / 255.0
        # The encoder changes so small a picture much, yet less than a move does.
        assert -10 * math.log10(float(np.mean((ours - theirs) ** 2))) > 27
    said = []
    for number in range(row["dataset_from_index"], row["dataset_to_index"]):
        action = frames.hf_dataset[number]["action"].numpy()[None]
        *_, terminated, truncated, info = env.step(action)
        said.append(bool(info["is_success"][0]))
        if terminated[0] or truncated[0]:
            break
    env.close()
    assert terminated[0]
    assert said == [False] * (len(said) - 1) + [True]


def test_the_hub_makes_the_same_environments() -> None:
    utils = import_module("lerobot.envs.utils")
    module = utils._load_module_from_path(str(ROOT / "integrations/envhub/env.py"))
    made = utils._normalize_hub_result(utils._call_make_env(module, 1, False, None))
    assert tuple(made) == lemma.SUITE
    every = made["hook_stack"][0]
    assert every.single_action_space.shape == STATE_AND_ACTION["action"]
    utils.close_envs(made)


def test_lemma_evaluate_plays_the_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Rollout, "horizon_s", 2.0)
    found = lemma.evaluate(
        f"lerobot:{checkpoint()}", tasks="stack", split="val", episodes=2
    )
    assert not found.errors
    assert len(found.result.about["weights"]["act"]["sha256"]) == 64
    for row in found.rows:
        assert row["control"]["hz"] == 10.0
        assert (row["control"]["actions"], row["control"]["asked"]) == (20, 2)


@pytest.mark.parametrize(
    ("one_by_one", "looks_on"), [(False, False), (True, False), (True, True)]
)
def test_it_acts_as_in_lerobots_evaluation(one_by_one: bool, looks_on: bool) -> None:
    """Many episodes at once, and with queues of their own, as one after the other."""
    module = import_module("lemma.policies.control.lerobot")
    policy = module.LeRobotPolicy(str(checkpoint()))
    policy._one_by_one, policy._looks_on = one_by_one, looks_on
    options = dict(policy.control_options)
    assert (options["width"], options["height"]) == (WIDTH, HEIGHT)
    envs = [
        lemma.make("pass", split="val", index=index, **options) for index in range(2)
    ]
    observations = [env.reset()[0] for env in envs]
    robots = ("red robot", "white robot")
    memories = [None, None]
    rows: list[list[Any]] = [[], []]
    while len(rows[0]) < CHUNK:
        answers = policy.act(
            [
                ControlInput(instruction="", robots=robots, observation=o, memory=m)
                for o, m in zip(observations, memories, strict=True)
            ]
        )
        memories = [answer.memory for answer in answers]
        for own, answer in zip(rows, answers, strict=True):
            own.extend(chunk_of(answer.rows, (2, 7)))
    for observation, own in zip(observations, rows, strict=True):
        expected = as_lerobot(policy, observation)
        assert np.allclose(np.array(own).reshape(CHUNK, 14), expected, atol=1e-4)
    assert not np.allclose(rows[0], rows[1], atol=1e-4)


def test_published_in_one_file_it_acts_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = import_module("lemma.policies.control.lerobot")
    publish = import_module("publish_weights")
    monkeypatch.setattr(import_module("lemma.policies.weights"), "CHECKOUT", tmp_path)
    publish.pack(
        checkpoint(), "moves", publish.Fineness(512.0), tmp_path, "lerobot-train"
    )
    before, after = (
        module.LeRobotPolicy(name) for name in (str(checkpoint()), "moves")
    )
    assert after.control_options == before.control_options
    env = lemma.make("pass", split="val", **dict(before.control_options))
    given = ControlInput(
        instruction="", robots=("red robot", "white robot"), observation=env.reset()[0]
    )
    expected, found = (policy.act([given])[0].rows for policy in (before, after))
    # Of an angle [rad], or a share of an opening.
    assert np.allclose(expected, found, atol=5e-3)


def as_lerobot(policy: Any, observation: Any) -> NDArray[Any]:
    """Return what the rollout of lerobot-eval would do with one observation."""
    utils = import_module("lerobot.envs.utils")
    policy._policy.reset()
    found = []
    for _ in range(CHUNK):
        seen = {name: observation[name] for name in ("pixels", "agent_pos")}
        seen["environment_state"] = sentence_vector("")
        batch = utils.preprocess_observation(seen)
        action = policy._policy.select_action(policy._before({**batch, "task": [""]}))
        found.append(policy._after(action).detach().numpy()[0])
    return np.array(found)


STATE_AND_ACTION = {"observation.state": (14,), "action": (14,)}


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (STATE_AND_ACTION, "images are {}"),
        (STATE_AND_ACTION | {"observation.images.top": (3, 48, 64)}, "robot_0_wrist"),
        (
            STATE_AND_ACTION
            | {"observation.images.robot_0": (3, 48, 64)}
            | {"observation.images.robot_1": (3, 32, 64)},
            "all of one size",
        ),
        ({"observation.state": (6,), "action": (6,)}, "14 or 20 numbers"),
    ],
)
def test_policies_that_were_made_for_something_else_are_refused(
    shapes: dict[str, tuple[int, ...]], message: str
) -> None:
    module = import_module("lemma.policies.control.lerobot")
    made = {name: SimpleNamespace(shape=shape) for name, shape in shapes.items()}
    config = SimpleNamespace(input_features=made, output_features={})
    with pytest.raises(InvalidConfigError, match=message):
        module.control_options(config, 10.0)
