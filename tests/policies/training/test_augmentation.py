import atexit
import math
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import numpy as np
import pytest
import torch
from batches import labels_of
from painted_keyframes import RASTER, paint, write_painted
from rendered_sets import keyframes_folder
from tiers import slow_but
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import NOBODY, Batch
from lemma.policies.frames import Frames
from lemma.policies.text.instructions import with_instructions, with_language
from lemma.policies.training.augmentation import augment, move
from lemma.policies.training.config import Augmentation
from lemma.policies.training.recoloring import permute_colors
from lemma.scene.objects.entity import ENTITIES, SHARED
from lemma.scene.objects.palette import OBJECT_COLORS
from lemma.tasks.language.bank import parse

COLORS, PLACES = tuple(OBJECT_COLORS), (*ENTITIES, SHARED)
OFF = Augmentation.none()
EACH = {
    "palette": replace(OFF, palette=True),
    "translate": replace(OFF, translate_cells=6),
    "turn": replace(OFF, turn=True),
    "rotate": replace(OFF, rotate_deg=30.0),
    "brightness": replace(OFF, brightness=0.15),
    "pixel_noise": replace(OFF, pixel_noise=0.03),
    "height_noise": replace(OFF, height_noise_m=0.003),
    "dropouts": replace(OFF, dropouts=4),
    "all": Augmentation(),
}
EPISODES = 6


@cache
def frames() -> Frames:
    folder = Path(mkdtemp(prefix="lemma-painted-"))
    atexit.register(rmtree, folder, ignore_errors=True)
    write_painted(folder, {"val": EPISODES}, RASTER)
    return Frames.load(folder, "val")


@cache
def rendered() -> Frames:
    return Frames.load(keyframes_folder(), "val")


def whole(source: Frames) -> Batch:
    return source.batch(range(len(source)))


def shown_color(batch: Batch, frame: int, x: float, y: float) -> str | None:
    """Return which palette color a point of the map has; None if it is not seen."""
    row, column = batch.raster.pixel_from_world(x, y)
    if not batch.coverage[frame, row, column]:
        return None
    color = batch.rgb[frame, row, column].numpy() / 255.0
    distances = [np.abs(color - OBJECT_COLORS[name][:3]).max() for name in COLORS]
    return COLORS[int(np.argmin(distances))]


def assert_labels_fit_the_image(batch: Batch) -> int:
    """Check that each object that is on top shows its color; return how many are."""
    labels, count = labels_of(batch), 0
    for frame in range(len(batch)):
        objects = labels.objects[frame, :10]
        there = [e for e in range(10) if not torch.isnan(objects[e, 0])]
        for entity in there:
            x, y, z = objects[entity, :3].tolist()
            above = [
                o for o in there if o != entity and objects[o, 2] > z
                and math.dist(objects[o, :2].tolist(), (x, y)) < 0.08
            ]  # fmt: skip
            if above:
                continue
            row, column = batch.raster.pixel_from_world(x, y)
            top = z + (0.025 if entity < 5 else 0.004)
            # A robot may be in the way.
            if abs(float(batch.height_m[frame, row, column]) - top) > 0.014:
                continue
            color = shown_color(batch, frame, x, y)
            if color is not None:
                assert f"{color}_" in ENTITIES[entity]
                count += 1
    return count


def assert_decisions_fit(batch: Batch) -> None:
    """Check that what is picked is at the pose where the gripper closes."""
    labels = labels_of(batch)
    for frame, (robot, _, pick, _) in enumerate(labels.decision.tolist()):
        if pick == NOBODY:
            assert torch.isnan(labels.pick_pose[frame]).all()
            continue
        assert robot in (0, 1)
        found = labels.objects[frame, pick, :2]
        assert torch.allclose(found, labels.pick_pose[frame, :2], atol=1e-5)


@pytest.mark.parametrize("name", EACH)
def test_labels_are_right_after_every_augmentation(name: str) -> None:
    for draw in range(3):
        batch = augment(whole(frames()), EACH[name], stream(name, draw))
        assert assert_labels_fit_the_image(batch) > 4 * EPISODES
        assert_decisions_fit(batch)
        # Nothing is shown where no camera sees.
        assert not batch.rgb[~batch.coverage].any()
        assert not batch.height_m[~batch.coverage].any()
        assert torch.isfinite(batch.height_m).all()


@pytest.mark.render
@pytest.mark.parametrize("name", slow_but(EACH, "all"))
def test_labels_are_right_in_rendered_frames(name: str) -> None:
    batch = whole(rendered())
    before = assert_labels_fit_the_image(batch)
    batch = augment(batch, EACH[name], stream(name, "rendered"))
    # Some may be moved out of the map, or into a hole.
    assert assert_labels_fit_the_image(batch) > 0.8 * before


def same(first: Batch, second: Batch) -> bool:
    parts = [(first, second), (first.labels, second.labels)]
    for one, other in parts:
        for name in (field.name for field in fields(one)):  # type: ignore[arg-type]
            a, b = getattr(one, name), getattr(other, name)
            if isinstance(a, Tensor):
                if not torch.equal(a.nan_to_num(9.0), b.nan_to_num(9.0)):
                    return False
            elif name != "labels" and a != b:
                return False
    return True


def test_nothing_changes_when_all_is_off() -> None:
    batch = whole(frames())
    assert same(augment(batch, OFF, stream(0)), batch)


@pytest.mark.parametrize("name", EACH)
def test_augmentation_changes_something_and_depends_on_the_draw(name: str) -> None:
    batch = whole(frames())
    first = augment(batch, EACH[name], stream(1))
    assert not same(first, batch)
    assert same(first, augment(batch, EACH[name], stream(1)))
    assert not same(first, augment(batch, EACH[name], stream(2)))


def test_frames_of_an_episode_are_changed_alike() -> None:
    options = replace(OFF, palette=True, turn=True, translate_cells=6)
    batch = whole(frames())
    labels = labels_of(augment(batch, options, stream("alike")))
    bases = labels.bases.view(EPISODES, 3, 2, 3)
    assert (bases == bases[:, :1]).all()
    assert len({tuple(b.flatten().tolist()) for b in bases[:, 0]}) > EPISODES // 2
    for episode in range(EPISODES):
        assert len(set(labels.goals[3 * episode : 3 * episode + 3])) == 1


def turned(batch: Batch) -> Batch:
    every = torch.ones(len(batch), dtype=torch.bool)
    return move(batch, torch.zeros(len(batch), 2, dtype=torch.int64), every)


def test_two_half_turns_are_none() -> None:
    batch = whole(frames())
    again = turned(turned(batch))
    labels, before = labels_of(again), labels_of(batch)
    assert torch.equal(again.rgb, batch.rgb)
    assert torch.equal(again.height_m, batch.height_m)
    assert torch.equal(again.joints, batch.joints)
    assert torch.equal(again.past, batch.past)
    assert torch.equal(labels.decision, before.decision)
    assert labels.robot_colors == before.robot_colors
    for name in ("pick_pose", "place_pose", "bases"):
        a, b = getattr(labels, name), getattr(before, name)
        assert torch.allclose(a[..., :2], b[..., :2], equal_nan=True)
        assert torch.allclose(torch.cos(a - b).nan_to_num(1.0), torch.ones(()))
    a, b = labels.objects, before.objects
    assert torch.equal(a[..., :3].nan_to_num(9.0), b[..., :3].nan_to_num(9.0))
    # A quaternion and its opposite are one rotation.
    assert torch.allclose((a[..., 3:] * b[..., 3:]).sum(-1).abs().nan_to_num(1.0),
                          torch.ones(()))  # fmt: skip


def test_a_half_turn_moves_everything_together_with_its_robot() -> None:
    batch = whole(frames())
    after = turned(batch)
    labels, before = labels_of(after), labels_of(batch)
    assert torch.equal(after.rgb, batch.rgb.flip(1, 2))
    for frame, (robot, *_) in enumerate(before.decision.tolist()):
        if robot == NOBODY:
            assert int(labels.decision[frame, 0]) == NOBODY
            continue
        now = int(labels.decision[frame, 0])
        assert now == 1 - robot
        assert torch.equal(after.joints[frame, now], batch.joints[frame, robot])
        assert after.opening_m[frame, now] == batch.opening_m[frame, robot]
        assert labels.arms[frame, now] == before.arms[frame, robot]
        assert labels.robot_colors[frame][now] == before.robot_colors[frame][robot]
        for pose in ("pick_pose", "place_pose"):
            assert torch.allclose(
                _seen_from(labels.bases[frame, now], getattr(labels, pose)[frame]),
                _seen_from(before.bases[frame, robot], getattr(before, pose)[frame]),
                atol=1e-5,
            )
    first = labels.bases[:, 0]
    assert (first[:, 0] < 0).all()
    assert (first[:, 2].abs() < 0.5).all()


def _seen_from(base: Tensor, pose: Tensor) -> Tensor:
    """Return a pose in a robot's frame: x, y, and cosine and sine of the yaw."""
    dx, dy = (pose - base)[:2]
    c, s = torch.cos(base[2]), torch.sin(base[2])
    yaw = pose[2] - base[2]
    return torch.stack([c * dx + s * dy, c * dy - s * dx, yaw.cos(), yaw.sin()])


def test_rotated_objects_look_as_their_labels_say() -> None:
    batch = turned(whole(frames()))
    labels = labels_of(batch)
    for frame in range(len(batch)):
        poses = {}
        for entity, (x, y, z, w, _, _, q) in enumerate(labels.objects[frame].tolist()):
            if not math.isnan(x):
                poses[ENTITIES[entity]] = (x, y, z, 2 * math.atan2(q, w))
        rgb, _ = paint(poses, labels.robot_colors[frame], batch.raster)
        different = (torch.from_numpy(rgb) != batch.rgb[frame]).any(-1)
        # Cells at an edge may fall on either side.
        assert different.float().mean() < 0.002


def test_moving_shifts_cells_and_labels_alike() -> None:
    batch = whole(frames())
    shift = torch.tensor([[3, -5]]).expand(len(batch), 2)
    after = move(batch, shift, torch.zeros(len(batch), dtype=torch.bool))
    assert torch.equal(after.rgb[:, 3:, :-5], batch.rgb[:, :-3, 5:])
    assert not after.coverage[:, :3].any()
    assert not after.coverage[:, :, -5:].any()
    moved = labels_of(after).bases - labels_of(batch).bases
    expected = torch.tensor([-5 * 0.008, -3 * 0.008, 0.0])
    assert torch.allclose(moved, expected.expand_as(moved), atol=1e-6)


def permutation(batch: Batch, *colors: int) -> Tensor:
    return torch.tensor([colors]).expand(len(batch), 5)


def test_colors_can_be_exchanged_back() -> None:
    batch = whole(frames())
    there, back = (2, 0, 4, 1, 3), (1, 3, 0, 4, 2)
    changed = permute_colors(batch, permutation(batch, *there))
    again = permute_colors(changed, permutation(batch, *back))
    assert (changed.rgb != batch.rgb).any(-1).float().mean() > 0.005
    assert (again.rgb.int() - batch.rgb.int()).abs().max() <= 2
    assert same(replace(again, rgb=batch.rgb), batch)


def test_colors_change_in_names_goals_and_past() -> None:
    batch = whole(frames())
    changed = permute_colors(batch, permutation(batch, 1, 2, 3, 4, 0))
    labels, before = labels_of(changed), labels_of(batch)
    new = dict(zip(COLORS, (*COLORS[1:], COLORS[0]), strict=True))

    def renamed(name: str) -> str:
        color, _, kind = name.partition("_")
        return f"{new[color]}_{kind}" if kind else name

    for frame in range(len(batch)):
        assert labels.goals[frame] == tuple(
            (renamed(top), renamed(bottom)) for top, bottom in before.goals[frame]
        )
        rows = [(labels.decision, before.decision), (changed.past, batch.past)]
        for now, then in rows:
            for a, b in zip(
                now[frame].view(-1, 4).tolist(),
                then[frame].view(-1, 4).tolist(),
                strict=True,
            ):
                assert a[:2] == b[:2]
                if b[2] != NOBODY:
                    assert ENTITIES[a[2]] == renamed(ENTITIES[b[2]])
                    assert PLACES[a[3]] == renamed(PLACES[b[3]])
                else:
                    assert a[2:] == b[2:]


def test_only_objects_are_painted() -> None:
    batch = whole(frames())
    for draw in range(5):
        colors = stream("paint", draw).permutation(5).tolist()
        changed = permute_colors(batch, permutation(batch, *colors))
        painted = (changed.rgb != batch.rgb).any(-1)
        # The table, the stick at 3 cm and the robots at 40 cm keep their colors.
        palette = torch.tensor([OBJECT_COLORS[c][:3] for c in COLORS])
        near = (batch.rgb[painted][:, None] / 255.0 - palette).abs().amax(-1).amin(-1)
        assert (near < 0.01).all()
        assert (batch.height_m[painted] < 0.11).all()


def test_what_lies_over_an_object_keeps_its_color() -> None:
    source = whole(frames())
    labels = labels_of(source)
    batch = replace(source, rgb=source.rgb.clone(), height_m=source.height_m.clone())
    x, y = labels.objects[0, int(labels.decision[0, 2]), :2].tolist()
    row, column = batch.raster.pixel_from_world(x, y)
    # An arm of the cube's very color, and a shadow of the camera.
    batch.height_m[0, row - 4 : row, column - 4 : column + 4] = 0.3
    batch.rgb[0, row : row + 4, column - 4 : column] = 0
    changed = permute_colors(batch, permutation(batch, 1, 2, 3, 4, 0))
    arm = (0, slice(row - 4, row), slice(column - 4, column + 4))
    shadow = (0, slice(row, row + 4), slice(column - 4, column))
    assert torch.equal(changed.rgb[arm], batch.rgb[arm])
    assert torch.equal(changed.rgb[shadow], batch.rgb[shadow])
    rest = (0, slice(row, row + 2), slice(column, column + 2))
    assert (changed.rgb[rest] != batch.rgb[rest]).any(-1).all()


def test_light_and_shade_stay() -> None:
    source = whole(frames())
    half = replace(source, rgb=source.rgb // 2)
    chosen = permutation(source, 3, 4, 2, 0, 1)
    bright, dark = (permute_colors(b, chosen).rgb.int() for b in (source, half))
    cubes = (source.height_m > 0.04) & (source.height_m < 0.11)
    assert (bright[cubes] - 2 * dark[cubes]).abs().max() <= 6


def test_sentences_say_the_goal_whatever_the_colors() -> None:
    for draw in range(5):
        batch = augment(whole(frames()), Augmentation(), stream("say", draw))
        batch = with_instructions(batch, seed=0, draw=draw)
        labels = labels_of(batch)
        for frame in range(len(batch)):
            assert parse(batch.instructions[frame]) == frozenset(labels.goals[frame])
            robot, _, pick, _ = labels.decision[frame].tolist()
            said = batch.sub_instructions[frame]
            if pick == NOBODY:
                assert said == "done"
                continue
            assert ENTITIES[pick].replace("_", " ") in said
            assert labels.robot_colors[frame][robot] in said.split(":")[0]


def test_an_episode_is_told_one_sentence_and_each_draw_another() -> None:
    batch = whole(frames())
    told = [with_instructions(batch, 0, draw).instructions for draw in range(12)]
    for sentences in told:
        for episode in range(EPISODES):
            assert len(set(sentences[3 * episode : 3 * episode + 3])) == 1
    assert len({sentences[0] for sentences in told}) > 2
    only = with_instructions(batch, 0, 0, ("high_level",)).instructions
    assert only == batch.instructions


def test_controls_say_nothing_or_what_was_said_to_others() -> None:
    batch = with_instructions(whole(frames()), 0, 0)
    assert with_language(batch, "full", stream(0)) is batch
    silent = with_language(batch, "none", stream(0))
    assert set(silent.instructions) == set(silent.sub_instructions) == {""}
    mixed = with_language(batch, "shuffled", stream(0))
    assert sorted(mixed.instructions) == sorted(batch.instructions)
    for a, b in zip(mixed.instructions, batch.instructions, strict=True):
        assert a != b
    for episode in range(EPISODES):
        assert len(set(mixed.instructions[3 * episode : 3 * episode + 3])) == 1


def test_noise_is_as_strong_as_said() -> None:
    batch = whole(frames())
    after = augment(batch, replace(OFF, height_noise_m=0.003), stream(0))
    difference = (after.height_m - batch.height_m)[batch.coverage]
    assert 0.0005 < difference.std() < 0.003
    assert abs(float(difference.mean())) < 0.0001
    after = augment(batch, replace(OFF, dropouts=4), stream(0))
    missing = (batch.coverage & ~after.coverage).sum((1, 2))
    assert 0 < missing.max() <= 4 * 8 * 8
