"""Frames that go into a LeRobotDataset; `make test-lerobot` reads them back."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rendered_sets import TASKS, recipe, recipe_folder
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.dataset.lerobot.export import LeRobotConfig
from lemma.dataset.lerobot.frames import (
    AGENT_PARTS,
    ENVIRONMENT_STATE,
    Style,
    describe_episode,
    features,
    frames,
    robots_of,
)
from lemma.dataset.rendered.render import RenderConfig
from lemma.dataset.rendered.steps import NO_SUBTASK, iterate_steps
from lemma.env.camera_rig import close_cameras
from lemma.env.learning.flat_view import FlatView
from lemma.env.learning.motor_state import (
    JOINT_POSITION,
    MOTOR_CONTROLS,
    motor_state,
)
from lemma.tasks.instance import Instance

STYLE = Style(fps=2, width_px=64, height_px=48)


@cache
def filmed() -> list[dict[str, Any]]:
    return list(frames(recipe()[0], STYLE))


@pytest.mark.render
def test_frames_are_the_steps_of_the_episode() -> None:
    record = recipe()[0]
    steps = list(iterate_steps(record, STYLE.fps))
    assert len(filmed()) == len(steps)
    for frame, step in zip(filmed(), steps, strict=True):
        state = frame["observation.state"].reshape(2, 7)
        assert np.array_equal(state[:, :6], step.joints.astype(np.float32))
        assert np.array_equal(state[:, 6], step.opening_m.astype(np.float32))
        assert np.array_equal(frame["action"], step.action.ravel().astype(np.float32))
        for number in range(2):
            own = {part: frame[f"robot_{number}.{part}"] for part in AGENT_PARTS}
            assert np.array_equal(own["state"], state[number])
            assert np.array_equal(own["action"], frame["action"].reshape(2, 7)[number])
        assert frame["next.done"].tolist() == [step.is_done]
        assert frame["next.reward"].tolist() == [step.reward]
        if step.subtask != NO_SUBTASK:
            assert frame["subtask"] == record.subtasks[step.subtask].instruction
        assert frame["task"] == frame["annotation.instruction.high_level"]
        assert frame["annotation.instruction.unseen"] == record.unseen
    assert filmed()[-1]["subtask"] == "done"
    assert filmed()[-1]["next.success"].tolist() == [record.success]


@pytest.mark.render
@pytest.mark.parametrize("depth", slow_but([True, False], True))
def test_features_are_what_frames_hold(depth: bool) -> None:
    style = Style(fps=2, width_px=64, height_px=48, depth=depth)
    frame = next(frames(recipe()[0], style))
    holds = features(robots_of(recipe()[0]), style)
    assert set(frame) == {*holds, "task"}
    for name, feature in holds.items():
        if feature["dtype"] == "string":
            assert isinstance(frame[name], str)
        else:
            assert frame[name].shape == feature["shape"]
            is_color = "images" in name and not name.endswith("_depth")
            kind = "uint8" if is_color else feature["dtype"]
            assert frame[name].dtype == kind.replace("video", "float32")
    assert len(holds) == (23 if depth else 18)
    # State and action are one row of each robot.
    rows = {name for name in holds if name.startswith(("observation.", "action"))}
    assert {name for name in rows if "images" not in name} == {
        "observation.state",
        "action",
    }


@pytest.mark.slow
@pytest.mark.render
def test_another_sentence_can_be_the_task() -> None:
    assert next(frames(recipe()[0], STYLE, "human"))["task"] == recipe()[0].human


@pytest.mark.render
def test_other_cameras_can_film() -> None:
    style = Style(
        fps=2, width_px=64, height_px=48, cameras=("overview", "robot_1_wrist")
    )
    frame = next(frames(recipe()[0], style))
    holds = features(robots_of(recipe()[0]), style)
    assert {name for name in holds if "images" in name} == {
        f"observation.images.{camera}{more}"
        for camera in style.cameras
        for more in ("", "_depth")
    }
    assert set(frame) == {*holds, "task"}
    told = describe_episode(recipe()[0], style, "human", 7)
    assert tuple(told["cameras"]) == style.cameras
    with pytest.raises(UnknownNameError, match="robot_0_wrist"):
        features(robots_of(recipe()[0]), Style(cameras=("robot_2",)))


def test_without_pictures_frames_may_hold_the_truth_as_environments_tell_it() -> None:
    record = recipe()[0]
    style = Style(fps=2, images=False, environment_state="privileged")
    found = list(frames(record, style))
    holds = features(robots_of(record), style)
    assert set(found[0]) == {*holds, "task"}
    assert not any("images" in name for name in holds)
    assert describe_episode(record, style, "human", 7)["cameras"] == {}
    env = FlatView(
        lemma.make(
            record.task,
            level="control",
            split=record.split,
            index=record.index,
            observation="privileged",
        )
    )
    observation, _ = env.reset()
    for name in ("observation.state", ENVIRONMENT_STATE):
        assert np.allclose(found[0][name], observation[name], atol=1e-6)
    names = holds[ENVIRONMENT_STATE]["names"]
    assert names is not None
    first, last = (
        dict(zip(names, found[at][ENVIRONMENT_STATE], strict=True)) for at in (0, -1)
    )
    (top, bottom), *_ = Instance.from_dict(record.instance_data()).goal.pairs
    before_m, after_m = (
        math.dist(*([told[f"{one}.{axis}"] for axis in "xy"] for one in (top, bottom)))
        for told in (first, last)
    )
    assert after_m < 0.03 < before_m
    assert first[f"{top}.on.{bottom}"] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control", "fps"), [(JOINT_POSITION, 5), *((one, 20) for one in MOTOR_CONTROLS)]
)
def test_what_was_commanded_solves_the_task_again(control: str, fps: int) -> None:
    record = recipe()[0]
    style = Style(fps=fps, images=False, control=control)
    found = list(frames(record, style))
    holds = features(robots_of(record), style)
    assert holds["action"]["names"] == holds["observation.state"]["names"]
    env = lemma.make(record.task, control=control, control_hz=fps, clip_actions=True)
    instance = Instance.from_dict(record.instance_data())
    observation, _ = env.reset(options={"instance": instance})
    measured = motor_state(control, observation)
    assert np.allclose(found[0]["observation.state"], measured.ravel(), atol=1e-6)
    for frame in found + [found[-1]] * (2 * fps):
        *_, ended, _, info = env.step(frame["action"].reshape(measured.shape))
        if ended:
            break
    assert info["success"]


def test_what_the_format_has_no_place_for_is_described() -> None:
    told = describe_episode(recipe()[0], STYLE, "human", 7)
    assert told["key"] == recipe()[0].key
    assert told["length"] == 7
    assert told["instruction"] == "human"
    assert tuple(told["cameras"]) == close_cameras(("robot_0", "robot_1"))
    matrix = np.array(told["cameras"]["robot_0_reach"]["world_from_camera"])
    # It looks down at the table.
    assert matrix[2, 3] > 0.5
    assert matrix[2, 2] < 0


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"fps": 30}, InvalidConfigError),
        ({"width_px": 63}, InvalidConfigError),
        ({"height_px": 16}, InvalidConfigError),
        ({"instructions": ("poem",)}, UnknownNameError),
        ({"environment_state": "poem"}, UnknownNameError),
        ({"cameras": ("overview",), "images": False}, InvalidConfigError),
        ({"cameras": ("overview", "overview")}, InvalidConfigError),
    ],
)
def test_styles_that_cannot_be(changes: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        Style(**changes)


def test_shards_hold_every_episode_once_and_training_first(tmp_path: Path) -> None:
    source = RenderConfig(recipe=recipe_folder(), out=tmp_path)
    shards = LeRobotConfig(source=source, per_video=1).shards()
    assert len(shards) == source.episodes()
    assert len({shard.folder for shard in shards}) == len(shards)
    assert [shard.path.stem for shard in shards] == [
        task for task in TASKS for _ in range(len(shards) // len(TASKS))
    ]
    assert all(shard.path.is_absolute() for shard in shards)
    together = LeRobotConfig(source=source).shards()
    assert sum(len(shard.rows) for shard in together) == len(shards)
    assert len(together) < len(shards)
    twice = Style(instructions=("high_level", "human"))
    halves = LeRobotConfig(source=source, style=twice, per_video=2).shards()
    assert [len(shard.rows) for shard in halves] == [1] * len(shards)
