"""Key poses: how the expert and a model move by them, and what a model learns from."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from kept import kept_folder
from tiers import slow_but

from lemma.core.seeding import stream
from lemma.core.workers.pool import Serial
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.rendered.key_poses import KeyPoseForm
from lemma.dataset.rendered.render import RenderConfig, render
from lemma.env.control.key_poses import (
    CONTROL,
    KINDS,
    NOWHERE,
    KeyPose,
    Kind,
    Progress,
    go_on,
    pose_matrices,
    set_out,
)
from lemma.env.control.modes import CONTROLS
from lemma.evaluation.run.control import ControlPlayer
from lemma.policies.batch import Batch
from lemma.policies.control.oracle import ExpertKeyPoses
from lemma.policies.frames import Frames
from lemma.policies.models.keypose import KeyPoseConfig, KeyPoseModel
from lemma.policies.text.instructions import with_instructions
from lemma.policies.training.augmentation import augment
from lemma.policies.training.config import Augmentation
from lemma.robots.ur.kinematics import top_down
from lemma.tasks.suite import load_instance

TASKS = ("lift", "place")
TINY = KeyPoseConfig(
    widths=(16, 16, 16, 16), text_width=32, text_layers=1, state_width=8, bins=8
)
HOME = (-0.2, 0.5, 0.42, 2.0)
BASES = [np.eye(4), np.eye(4)]


def frames() -> Frames:
    """Return the key poses of two episodes, at a small size."""

    def make(out: Path) -> None:
        recipe = out / "recipe"
        generate(
            GenerateConfig(out=recipe, tasks=TASKS, splits=("val",), episodes=1),
            Serial(),
        )
        order = RenderConfig(recipe=recipe, out=out / "data")
        render(order, KeyPoseForm(160, 120), Serial())

    return Frames.load(kept_folder("key_poses", make) / "data", "val")


def batch() -> Batch:
    found = frames()
    return with_instructions(found.batch(range(len(found))), 0, 0)


def begun() -> Progress:
    return Progress.begin([top_down(*HOME), top_down(*HOME)], np.array([0.1, 0.1]))


def waypoints(key: KeyPose, progress: Progress) -> tuple[Progress, np.ndarray]:
    """Return all waypoints to a key pose, of an arm that is at once where it is led."""
    hands = [top_down(*row[:4]) for row in progress.rows]
    progress = set_out(progress, key, hands[max(0, key.robot)])
    rows: list[Any] = []
    while True:
        hands = [top_down(*row[:4]) for row in progress.rows]
        progress, chunk = go_on(progress, BASES, hands)
        if chunk is None:
            return progress, np.concatenate(rows) if rows else np.empty((0, 2, 8))
        rows.append(chunk)


@pytest.mark.parametrize("task", slow_but(["lift", "place", "poke"], "place"))
def test_the_experts_key_poses_solve(task: str) -> None:
    policy = ExpertKeyPoses()
    player = ControlPlayer(policy)
    rollout: Any = player.begin(load_instance(task, "val", 0), "high_level")
    while not rollout.episode.is_over:
        given = player.policy_input(rollout)
        rollout.take(given, policy.act([given])[0])
    assert rollout.episode.is_success


def test_a_hand_comes_from_above_closes_rises_and_returns() -> None:
    end, rows = waypoints(KeyPose(0, Kind.PICK, 0.5, 0.1, 0.02, 2.0), begun())
    lowest = rows[:, 0, 2].argmin()
    assert np.allclose(rows[lowest, 0, :3], [0.5, 0.1, 0.02], atol=1e-6)
    assert (rows[: lowest + 1, 0, 7] > 0.09).all()
    assert (rows[-1, 0, 7], end.rows[0, 2]) == (0.0, pytest.approx(HOME[2]))
    assert (rows[:, 1] == rows[0, 1]).all(), "the other arm stays"
    mode = CONTROLS[CONTROL]
    assert (rows >= np.array(mode.low, np.float32)).all()
    assert (rows <= np.array(mode.high, np.float32)).all()


def test_half_a_turn_of_a_grasp_goes_on_to_where_it_is_put() -> None:
    away = HOME[3] + math.pi - 0.1
    picked, _ = waypoints(KeyPose(0, Kind.PICK, 0.5, 0.1, 0.02, away), begun())
    assert picked.turned
    _, rows = waypoints(KeyPose(0, Kind.PUT, 0.5, 0.3, 0.02, 1.0), picked)
    hand = pose_matrices(rows[rows[:, 0, 2].argmin(), 0, :7])[0]
    assert np.allclose(hand, top_down(0.5, 0.3, 0.02, 1.0 + math.pi), atol=1e-5)


def test_nothing_is_done_where_there_is_nothing_to_do() -> None:
    assert len(waypoints(NOWHERE, begun())[1]) == 0


@pytest.mark.slow
@pytest.mark.render
def test_data_hold_a_frame_for_each_key_pose() -> None:
    labels = batch().labels
    assert labels is not None
    assert labels.kind_and_height is not None
    kinds = [KINDS[int(number)] for number in labels.kind_and_height[:, 0]]
    assert kinds == [Kind.PICK, Kind.PICK, Kind.PUT]
    assert labels.tasks == ["lift", "place", "place"]
    held = labels.decision[2, 0]
    assert 0.01 < batch().opening_m[2, held] < 0.09, "seen with the cube in hand"
    assert (labels.pick_pose == labels.place_pose).all()


@pytest.mark.render
def test_what_is_changed_at_random_changes_the_key_pose_with_it() -> None:
    before = batch()
    after = augment(before, Augmentation(translate_cells=0), stream("test", 1))
    assert before.labels is not None
    assert after.labels is not None
    assert before.labels.kind_and_height is not None
    assert after.labels.kind_and_height is not None
    assert (after.labels.kind_and_height == before.labels.kind_and_height).all(), (
        "heights and kinds stay"
    )
    for old, new in zip(
        before.labels.pick_pose[:, :2], after.labels.pick_pose[:, :2], strict=True
    ):
        assert torch.allclose(old, new) or torch.allclose(old, -new)
    said = with_instructions(after, 0, 3, paraphrases=1.0)
    assert all(said.instructions)


@pytest.mark.render
def test_a_model_has_finite_losses_and_scores() -> None:
    torch.manual_seed(0)
    model, given = KeyPoseModel(TINY), batch()
    losses = model.loss(given)
    sum(losses.values(), torch.zeros(())).backward()
    assert all(value.isfinite() for value in losses.values())
    assert all(weight.grad is not None for weight in model.parameters())
    scores = model.eval().score(given)
    assert scores["decided"].shape == (3,)


@pytest.mark.render
def test_a_model_moves_one_arm_and_looks_again() -> None:
    torch.manual_seed(0)
    model = KeyPoseModel(TINY).eval()
    player = ControlPlayer(model)
    rollout: Any = player.begin(load_instance("lift", "val", 0), "high_level")
    given = player.policy_input(rollout)
    alone, together = model.act([given])[0], model.act([given, given])[1]
    assert np.array_equal(np.asarray(alone.rows), np.asarray(together.rows))
    rollout.take(given, alone)
    assert rollout.actions == len(np.asarray(alone.rows))
    assert model.act([player.policy_input(rollout)])[0].memory.legs
