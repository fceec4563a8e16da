"""Rotations of training scenes by any angle."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from batches import labels_of
from painted_keyframes import RASTER, write_painted
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import NOBODY, Batch
from lemma.policies.frames import Frames
from lemma.policies.models.grid import seen_from
from lemma.policies.training.augmentation import augment, move, rotate
from lemma.policies.training.config import Augmentation


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Batch:
    folder: Path = tmp_path_factory.mktemp("painted")
    write_painted(folder, {"val": 6}, RASTER)
    frames = Frames.load(folder, "val")
    return frames.batch(range(len(frames)))


def test_half_a_rotation_is_a_half_turn_with_the_same_robots(batch: Batch) -> None:
    still, every = torch.zeros(len(batch), 2, dtype=torch.int64), torch.ones(len(batch))
    expected = move(batch, still, every.bool())
    found = rotate(batch, math.pi * every)
    labels, others = labels_of(found), labels_of(expected)
    assert torch.equal(found.rgb, expected.rgb)
    assert torch.equal(found.height_m, expected.height_m)
    assert torch.equal(labels.decision, labels_of(batch).decision)
    assert torch.allclose(labels.objects, others.objects, atol=1e-6, equal_nan=True)
    bases = others.bases.flip(1)
    for a, b in ((labels.bases, bases), (labels.place_pose, others.place_pose)):
        assert torch.allclose(a[..., :2], b[..., :2], atol=1e-6, equal_nan=True)
        yaws = torch.cos(a[..., 2] - b[..., 2])
        assert torch.allclose(yaws.nan_to_num(1.0), torch.ones(()))


def test_a_motion_is_the_same_from_its_robot_after_a_rotation(batch: Batch) -> None:
    angle = torch.linspace(-1.0, 1.0, len(batch))
    found, expected = _from_robots(rotate(batch, angle)), _from_robots(batch)
    assert len(found) > len(batch) // 2
    assert torch.allclose(found, expected, atol=1e-5)


def _from_robots(batch: Batch) -> Tensor:
    """Return the ends of motions in the frames of the robots' bases, (N, 4) [m]."""
    labels = labels_of(batch)
    robots = labels.decision[:, 0]
    acts = robots != NOBODY
    bases = labels.bases[acts, robots[acts]]
    poses = labels.pick_pose[acts], labels.place_pose[acts]
    return torch.cat([seen_from(bases, pose[:, :2]) for pose in poses], 1)


def test_scenes_with_a_gap_or_a_motion_off_the_map_stay(batch: Batch) -> None:
    labels = labels_of(batch)
    gap_m, place = labels.gap_m.clone(), labels.place_pose.clone()
    objects, corner = labels.objects.clone(), torch.tensor(batch.raster.size_m) / 2
    # One frame of an episode is enough.
    gap_m[0] = torch.tensor([-0.1, 0.1])
    place[-1, :2] = corner - 0.1
    acts = (labels.decision[:, 2] != NOBODY) & (labels.episode == labels.episode[6])
    frame = int(acts.nonzero()[0])
    objects[frame, labels.decision[frame, 2], :2] = corner - 0.1
    new = replace(labels, gap_m=gap_m, place_pose=place, objects=objects)
    options = replace(Augmentation.none(), rotate_deg=89.0)
    for draw in range(5):
        found = augment(replace(batch, labels=new), options, stream("rotate", draw))
        off = (labels_of(found).bases - labels.bases)[..., :2].abs()
        stays = off.flatten(1).amax(1) == 0.0
        spoiled = {int(labels.episode[k]) for k in (0, frame, -1)}
        assert len(spoiled) == 3
        assert stays.tolist() == [int(one) in spoiled for one in labels.episode]
        assert torch.equal(found.rgb[stays], batch.rgb[stays])


def test_the_first_robot_of_a_pair_stays_at_minus_x(batch: Batch) -> None:
    options, turned = replace(Augmentation.none(), rotate_deg=180.0), 0
    for draw in range(5):
        found = augment(batch, options, stream("pair", draw))
        bases, before = labels_of(found).bases, labels_of(batch).bases
        assert (bases[:, 0, 0] < bases[:, 1, 0]).all()
        turned += int((bases[:, 0, 1] != before[:, 0, 1]).sum())
    assert turned > len(batch)
