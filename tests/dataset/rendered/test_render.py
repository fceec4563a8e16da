"""From a recipe to images of its keyframes: what they show, and what survives."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import run
from rendered_sets import (
    SPLIT,
    keyframes_folder,
    recipe,
    recipe_folder,
)

from lemma.core.errors import DatasetError, InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose
from lemma.dataset.recipe.files import REVISION_VARIABLE
from lemma.dataset.rendered.capture import KeyframeForm, stored
from lemma.dataset.rendered.dataset import (
    CAMERA_COLUMNS,
    MAP_COLUMNS,
    POLICY_COLUMNS,
    KeyframeDataset,
    Sample,
)
from lemma.dataset.rendered.render import RenderConfig
from lemma.env.camera_rig import CameraRig
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.scene.cameras import Camera, CameraImage, CameraIntrinsics
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.scene.raster import decode_depth
from lemma.scene.scene import Scene
from lemma.scene.topdown_map import fuse
from lemma.tasks.instance import Instance

pytestmark = pytest.mark.render

SMALL = KeyframeForm(80, 60)


@pytest.fixture(autouse=True)
def _one_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REVISION_VARIABLE, "of-the-tests")


def everything() -> KeyframeDataset:
    columns = (*MAP_COLUMNS, *CAMERA_COLUMNS, *POLICY_COLUMNS)
    return KeyframeDataset(
        keyframes_folder(),
        SPLIT,
        columns=(*columns, "objects", "instance", "outcome", "goal", "time_s"),
    )


def scene_at(episode: int, keyframe: int) -> Scene:
    record = recipe()[episode]
    scene = Scene(Instance.from_dict(record.instance_data()).scene)
    scene.restore(record.state(keyframe))
    return scene


def cameras(sample: Sample, names: Sequence[str]) -> list[Camera]:
    found = []
    _, height, width, _ = sample["rgb"].shape
    for name, lens, pose in zip(
        names, sample["intrinsics"], sample["world_from_camera"], strict=True
    ):
        intrinsics = CameraIntrinsics(
            width, height, lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]
        )
        found.append(Camera(name, Pose.from_matrix(pose), intrinsics))
    return found


def test_what_is_decoded_is_what_was_rendered_bit_for_bit() -> None:
    dataset, rig = everything(), CameraRig()
    for episode, frames in enumerate(dataset.episodes()):
        for keyframe, index in enumerate(frames):
            sample = dataset[index]
            shown = stored(rig.look(scene_at(episode, keyframe)))
            for name in (*MAP_COLUMNS, *CAMERA_COLUMNS):
                assert sample[name].dtype == shown[name].dtype
                assert np.array_equal(sample[name], shown[name]), name


def test_what_is_stored_can_be_fused_to_the_same_map() -> None:
    dataset = everything()
    for index in (0, len(dataset) - 1):
        sample = dataset[index]
        images = [
            CameraImage(rgb, decode_depth(depth), camera)
            for rgb, depth, camera in zip(
                sample["rgb"],
                sample["depth"],
                cameras(sample, ("robot_0", "robot_1")),
                strict=True,
            )
        ]
        fused = fuse(images)
        assert np.array_equal(sample["map_coverage"], fused.coverage)
        differing = (sample["map_rgb"] != fused.rgb).any(-1)
        height = dataset.raster.decode_height(sample["map_height"])
        assert differing.mean() < 1e-4
        assert np.abs(height - fused.height_m)[~differing].max() < 0.6e-4


def color_of(pixels: np.ndarray) -> str:
    """Return the palette's color that pixels have, by hue and whiteness."""
    shown = np.median(pixels.reshape(-1, 3), axis=0) / 255.0
    shown = shown / np.linalg.norm(shown)

    def similarity(name: str) -> float:
        named = np.array(OBJECT_COLORS[name][:3])
        return float(shown @ named / np.linalg.norm(named))

    return max(OBJECT_COLORS, key=similarity)


def test_cubes_lie_in_the_map_where_they_are() -> None:
    dataset, seen = everything(), 0
    for index in range(len(dataset)):
        sample = dataset[index]
        episode = next(e for e, r in enumerate(dataset.episodes()) if index in r)
        scene = scene_at(episode, sample["keyframe"])
        entities = dataset.shards[0].header.entities
        for name in scene.spec.object_names:
            pose = scene.pose(name)
            stored = sample["objects"][entities.index(name)]
            assert stored.tolist() == [*pose.position, *pose.quaternion]
            color, _, kind = name.partition("_")
            row, column = dataset.raster.pixel_from_world(*pose.position[:2])
            patch = np.s_[row - 1 : row + 2, column - 1 : column + 2]
            if kind != "cube" or not sample["map_coverage"][patch].all():
                continue
            height = dataset.raster.decode_height(sample["map_height"][patch])
            top = pose.position[2] + CUBE_EDGE_M / 2
            if np.abs(np.median(height) - top) > 0.005:
                continue
            assert color_of(sample["map_rgb"][patch]) == color
            seen += 1
    # Some are under another cube or a robot, most are not.
    assert seen >= 0.6 * sum(
        len([n for n in scene_at(e, 0).spec.object_names if n.endswith("cube")])
        * len(frames)
        for e, frames in enumerate(dataset.episodes())
    )


def test_labels_are_those_of_the_recipe() -> None:
    dataset = everything()
    for record, frames in zip(recipe(), dataset.episodes(), strict=True):
        for subtask, index in zip(record.subtasks, frames, strict=False):
            sample = dataset[index]
            for name in ("robot", "primitive", "pick", "place", "outcome"):
                assert sample[name] == getattr(subtask, name)
            assert sample["sub_instruction"] == subtask.instruction
            assert sample["pick_pose"].tolist() == list(subtask.pick_pose)
            assert sample["place_pose"].tolist() == list(subtask.place_pose)
        last = dataset[frames[-1]]
        assert (last["primitive"], last["robot"], last["pick"]) == ("stop", "", "")
        assert np.isnan(last["pick_pose"]).all()
        assert last["outcome"] == "stopped"


def test_the_rest_of_a_keyframe() -> None:
    dataset = everything()
    record, sample = recipe()[1], dataset[dataset.episodes()[1][1]]
    instance = Instance.from_dict(record.instance_data())
    assert sample["instance"] == record.instance
    assert json.loads(sample["goal"]) == [list(pair) for pair in instance.goal.pairs]
    assert sample["time_s"] == record.keyframe_time_s[1]
    assert sample["arms"] == "+".join(robot.arm for robot in instance.scene.robots)
    base = instance.scene.robots[1].base
    assert sample["bases"][1].tolist() == [base.x, base.y, base.yaw]
    scene = scene_at(1, 1)
    for number, robot in enumerate(scene.robots):
        assert np.array_equal(sample["joints"][number], scene.data.qpos[robot.qpos])
    assert np.abs(sample["opening_m"] - FINGER_OPENING_M).max() < 0.06


def test_an_episode_looks_the_same_whatever_was_rendered_before() -> None:
    first, second = list(recipe())[:2]
    after = [row["map_rgb"] for r in (first, second) for row in SMALL.rows(r)]
    alone = [row["map_rgb"] for row in SMALL.rows(second)]
    assert all(
        np.array_equal(a, b)
        for a, b in zip(after[first.keyframes :], alone, strict=True)
    )


def order(out: Path, **changes: Any) -> RenderConfig:
    return RenderConfig(recipe=recipe_folder(), out=out, **changes)


def test_a_state_that_was_changed_is_not_rendered() -> None:
    record = recipe()[0]
    states = (record.keyframe_state[0][:-8] + bytes(8), *record.keyframe_state[1:])
    changed = type(record)(
        **{name: getattr(record, name) for name in record.__slots__}
        | {"keyframe_state": states}
    )
    with pytest.raises(DatasetError, match=r"state of keyframe 0 of .* is damaged"):
        next(SMALL.rows(changed))


def test_names_are_checked(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'stack'"):
        order(tmp_path, tasks=("stak",)).groups()
    with pytest.raises(UnknownNameError, match="split in this recipe"):
        order(tmp_path, splits=("train",)).groups()
    with pytest.raises(InvalidConfigError, match="0 x 3"):
        KeyframeForm(0, 3)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "set"
    words = ("render", recipe_folder(), "--out", out, "--tasks", "pass")
    code = run(*words, "--size", "80x60", "--workers", 1, "--json")
    found = json.loads(capsys.readouterr().out)
    assert code == 0
    assert (found["form"], found["episodes"], found["made"]) == ("keyframes", 2, 2)
    dataset = KeyframeDataset(out, SPLIT, columns=("rgb",))
    assert len(dataset) == found["rows"] == 6
    assert dataset[0]["rgb"].shape == (2, 60, 80, 3)
    assert run(*words, "--size", "80x60") == 0
    assert "0 were made by this run" in capsys.readouterr().out
    assert "map_height" in (out / "README.md").read_text()
