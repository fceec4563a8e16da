"""Episodes that were led by hand, as data: done again, filmed, and what is refused."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lemma.cli.render import EVERYTHING, choose_form
from lemma.core.errors import DatasetError, InvalidConfigError, LemmaError
from lemma.core.poses import quaternion_from_matrix
from lemma.dataset.lerobot.frames import Style, frames
from lemma.dataset.lerobot.sources import check_source
from lemma.dataset.rendered.render import RenderConfig
from lemma.dataset.rendered.steps import iterate_steps
from lemma.dataset.teleoperation import (
    Commanded,
    Executed,
    Teleoperation,
    files_in,
    joints_sha256,
    perform,
    read_record,
)
from lemma.env.episode import Episode
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.tasks.suite import load_instance

STARTS_S = 2.0
"""When somebody takes over."""
ROWS, HZ = 30, 20.0
END_S = STARTS_S + ROWS / HZ


@pytest.fixture(scope="module")
def done() -> Teleoperation:
    """The first sub-task of the expert, broken off; then a hand that is moved up."""
    instance = load_instance("stack", "val", 0)
    rollout = Rollout(instance)
    player = Player.load(PolicySpec(ORACLE))
    for _ in roll_out([rollout], player):
        pass
    step = rollout.steps[0]
    assert step.grounded is not None
    begun = Executed.begin(0.0, step.subtask, step.grounded)
    begun = replace(begun, until_s=STARTS_S)
    episode = Episode(instance)
    draft = Teleoperation(instance, "put it there", (begun,), (), STARTS_S, "")
    perform(draft, episode)
    rows = []
    for arm in episode.simulation.arms.values():
        pose = arm.tcp_pose()
        turn = quaternion_from_matrix(pose[:3, :3])
        rows.append([*pose[:3, 3], *turn, arm.opening_m])
    row = np.array(rows)
    row[:, 2] += 0.05
    led = Commanded("ee_pose", HZ, [row] * ROWS, STARTS_S)
    draft = replace(draft, parts=(begun, led), end_s=END_S)
    episode = Episode(instance)
    perform(draft, episode)
    return replace(draft, end_sha256=joints_sha256(episode.simulation.scene.data.qpos))


@pytest.fixture(scope="module")
def file(done: Teleoperation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("led") / "mine.json"
    path.write_text(done.to_json())
    return path


def test_a_file_says_all_of_it(done: Teleoperation, file: Path) -> None:
    found = Teleoperation.load(file)
    # A table from a file is on no list.
    assert found.instance == replace(done.instance, split="own")
    assert found.to_json() == replace(done, instance=found.instance).to_json()


def test_it_is_a_record_with_a_keyframe_before_each_part(file: Path) -> None:
    record = read_record(file)
    assert [row.instruction for row in record.subtasks][1:] == ["Led by hand."]
    assert record.subtasks[0].outcome == "taken_over"
    assert record.keyframe_time_s == pytest.approx((0.0, STARTS_S, END_S))
    assert record.high_level == "put it there"
    assert not record.success


def test_it_is_filmed_step_by_step(file: Path) -> None:
    record = read_record(file)
    steps = list(iterate_steps(record, 10))
    assert len(steps) == round(10 * END_S) + 1
    owners = [step.subtask for step in steps]
    assert owners == [0] * 20 + [1] * 15 + [-1]
    assert steps[-1].is_done
    # The hand went where it was led: up.
    before, after = steps[20].joints, steps[-1].joints
    assert np.abs(after - before).max() > 0.02


@pytest.mark.slow
def test_frames_are_those_of_a_lerobot_data_set(file: Path) -> None:
    style = Style(fps=10, width_px=64, height_px=48, depth=False)
    found = list(frames(read_record(file), style))
    assert {frame["task"] for frame in found} == {"put it there"}
    assert [frame["subtask"] for frame in found][20:35] == ["Led by hand."] * 15
    assert found[0]["observation.images.robot_0_reach"].shape == (48, 64, 3)


def test_files_of_a_folder_are_found(file: Path, tmp_path: Path) -> None:
    assert files_in(file) == files_in(file.parent) == [file]
    assert files_in(tmp_path) == []
    # Other files are none: results, tables, pages.
    (tmp_path / "seed-0.json").write_text("{}")
    (tmp_path / "page.json").write_bytes(b"\xff")
    assert files_in(tmp_path) == files_in(tmp_path / "page.json") == []
    with pytest.raises(DatasetError, match="no recipe"):
        RenderConfig(recipe=tmp_path / "seed-0.json", out=tmp_path).groups()
    config = RenderConfig(recipe=file.parent, out=tmp_path)
    assert config.episodes() == 1
    with pytest.raises(InvalidConfigError, match="no keyframes"):
        choose_form("keyframes", config, EVERYTHING)
    with pytest.raises(InvalidConfigError, match="--tasks"):
        replace(config, tasks=("stack",)).groups()


def test_another_state_is_no_episode(done: Teleoperation, tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    path.write_text(replace(done, end_sha256="0" * 64).to_json())
    with pytest.raises(DatasetError, match="another state"):
        read_record(path)


def test_held_out_sentences_are_not_learned_from(
    done: Teleoperation, file: Path, tmp_path: Path
) -> None:
    check_source(file, [file], Style())
    with pytest.raises(DatasetError, match="--instructions"):
        check_source(file, [file], Style(instructions=("high_level", "human")))
    path = tmp_path / "unseen.json"
    said = replace(done, instruction=done.instance.instructions["unseen"])
    path.write_text(said.to_json())
    with pytest.raises(DatasetError, match="held out"):
        check_source(path, [path], Style())


def test_joints_that_were_commanded_have_no_waypoints(
    done: Teleoperation, file: Path, tmp_path: Path
) -> None:
    waypoints = Style(control="ee_waypoint_rot6d")
    check_source(file, [file], waypoints)
    begun, led = done.parts
    assert isinstance(led, Commanded)
    joints = replace(led, control="joint_position", rows=[np.zeros((2, 7))] * ROWS)
    path = tmp_path / "joints.json"
    path.write_text(replace(done, parts=(begun, joints)).to_json())
    check_source(path, [path], Style())
    with pytest.raises(DatasetError, match="joint_position commands joints"):
        check_source(path, [path], waypoints)


def test_waypoints_of_hands_are_where_they_were_led(
    done: Teleoperation, file: Path
) -> None:
    record = read_record(file)
    last = list(iterate_steps(record, 10))[-1]
    led = done.parts[-1]
    assert isinstance(led, Commanded)
    for pose, row in zip(last.waypoints, led.rows[-1], strict=True):
        assert np.allclose(pose[:3, 3], row[:3], atol=1e-9)


def test_a_table_alone_is_no_episode(done: Teleoperation, tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text(json.dumps(done.instance.to_dict()))
    with pytest.raises(InvalidConfigError, match="no valid steps"):
        check_source(path, [path], Style())


@pytest.mark.parametrize(
    ("part", "field", "value", "message"),
    [
        ("commanded", "control", "telepathy", "control"),
        ("commanded", "control", "joint_torque", "drives motors"),
        ("commanded", "control_hz", 33.0, "control_hz"),
        ("commanded", "rows", [[[0.0, 0.0]]], "shape"),
        ("commanded", "rows", [[[math.nan] * 8] * 2], "NaN|finite|number"),
        ("executed", "robot", "robot_7", "robot"),
        ("executed", "primitive", "juggle", "no valid steps"),
        ("executed", "pick_pose", [0.0, 0.0], "no valid steps"),
        ("executed", "pick_pose", [math.nan, 0.0, 0.0], "state"),
        ("", "end_s", math.nan, "nan s"),
        ("", "end_s", 1e9, "episodes end"),
        ("", "nudged", [{"time_s": 1.0, "name": "moon", "pose": [0, 0, 0]}], "moon"),
    ],
)
def test_what_was_written_by_somebody_else_ends_in_words(
    file: Path, tmp_path: Path, part: str, field: str, value: object, message: str
) -> None:
    data = json.loads(file.read_text())
    place = data["done"][part][0] if part else data["done"]
    place[field] = value
    path = tmp_path / "evil.json"
    path.write_text(json.dumps(data))
    with pytest.raises(LemmaError, match=message):
        read_record(path)
