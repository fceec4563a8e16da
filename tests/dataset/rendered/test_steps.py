"""An episode step by step."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rendered_sets import (
    recipe,
)

from lemma.core.errors import DatasetError, InvalidConfigError
from lemma.dataset.recipe.files import REVISION_VARIABLE
from lemma.dataset.recipe.schema import EpisodeRecord
from lemma.dataset.rendered.steps import DenseStep, iterate_steps

FIRST = 0
PER_S = 100


@pytest.fixture(autouse=True)
def _one_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(REVISION_VARIABLE, "of-the-tests")


@cache
def watched(hz: int) -> tuple[tuple[DenseStep, ...], tuple[np.ndarray, ...]]:
    """Return the steps of an episode, and the state that the scene was in at each."""
    steps, states = [], []
    for step in iterate_steps(recipe()[FIRST], hz):
        steps.append(step)
        states.append(step.scene.snapshot())
    return tuple(steps), tuple(states)


def test_steps_are_evenly_spaced_up_to_the_end() -> None:
    record = recipe()[FIRST]
    for hz in (10, 20):
        steps, _ = watched(hz)
        assert [step.index for step in steps] == list(range(len(steps)))
        assert [step.time_s for step in steps] == [i / hz for i in range(len(steps))]
        end = record.keyframe_time_s[-1]
        assert end - 1e-9 <= steps[-1].time_s < end + 1 / hz
        assert [step.is_done for step in steps] == [False] * (len(steps) - 1) + [True]


def test_the_scene_stands_at_the_step() -> None:
    steps, states = watched(10)
    record = recipe()[FIRST]
    assert np.array_equal(states[0], record.state(0))
    # The first number of a state is its time.
    for step, state in zip(steps, states, strict=True):
        assert state[0] == pytest.approx(step.time_s, abs=1e-9)
        scene = step.scene
        scene.restore(state)
        for number, robot in enumerate(scene.robots):
            assert np.array_equal(scene.data.qpos[robot.qpos], step.joints[number])
            assert np.array_equal(
                scene.data.qvel[robot.dof], step.joint_velocities[number]
            )
            assert scene.opening_m(robot) == step.opening_m[number]
        for name, pose in step.objects.items():
            assert pose.tolist()[:3] == list(scene.pose(name).position)


def test_another_rate_shows_the_same_motion() -> None:
    _, slow = watched(10)
    _, fast = watched(20)
    for index in range(len(slow) - 1):
        assert np.array_equal(slow[index], fast[2 * index])


def test_keyframes_are_passed_bit_for_bit() -> None:
    record = recipe()[FIRST]
    steps, states = watched(PER_S)
    for keyframe, time_s in enumerate(record.keyframe_time_s):
        index = round(time_s * PER_S)
        assert steps[index].time_s == pytest.approx(time_s)
        assert np.array_equal(states[index], record.state(keyframe))


def test_what_is_commanded_is_what_happens_next() -> None:
    steps, _ = watched(20)
    joints = np.array([step.joints for step in steps])
    actions = np.array([step.action for step in steps])
    assert actions.shape == (len(steps), 2, 7)
    behind = np.abs(actions[:-1, :, :6] - joints[1:])
    ahead = np.abs(actions[:-1, :, :6] - joints[:-1])
    assert behind.max() < 0.03
    moving = ahead > 0.05
    assert moving.any()
    assert (behind < ahead)[moving].all()
    assert np.array_equal(actions[-1], actions[-2])


def test_subtasks_are_those_of_the_recipe() -> None:
    record = recipe()[FIRST]
    hz = 10
    steps, _ = watched(hz)
    for step in steps[:-1]:
        row = record.subtasks[step.subtask]
        end_s = row.start_s + row.duration_s
        assert row.start_s - 1e-9 <= step.time_s < end_s
        following = steps[step.index + 1]
        # An action is what is commanded by the next step. Sub-tasks end between steps,
        # and the action in which one does is already of the next sub-task.
        if following.time_s + 1 / hz > end_s + 1e-9:
            continue
        (other,) = (n for n in (0, 1) if f"robot_{n}" != row.robot)
        assert np.array_equal(step.action[other, :6], following.action[other, :6])
    assert steps[-1].subtask == -1


def test_reward_comes_at_the_end() -> None:
    steps, _ = watched(10)
    assert [step.reward for step in steps[:-1]] == [0.0] * (len(steps) - 1)
    assert steps[-1].reward == 1.0
    assert steps[0].progress < 1.0 == steps[-1].progress
    failed = replace(recipe()[FIRST], success=False)
    assert list(iterate_steps(failed))[-1].reward == 0.0


def test_who_moves_the_scene_does_not_disturb_the_motion() -> None:
    _, expected = watched(10)
    for step, state in zip(iterate_steps(recipe()[FIRST]), expected, strict=True):
        assert np.array_equal(step.scene.snapshot(), state)
        step.scene.data.qpos[:] = 0.0


def drifting(record: EpisodeRecord) -> EpisodeRecord:
    first, *rest = record.subtasks
    x, y, yaw = first.pick_pose
    return replace(
        record, subtasks=(replace(first, pick_pose=(x + 1e-12, y, yaw)), *rest)
    )


def other_start(record: EpisodeRecord) -> EpisodeRecord:
    return replace(record, keyframe_sha256=("0" * 64, *record.keyframe_sha256[1:]))


@pytest.mark.parametrize(("change", "at"), [(drifting, 1), (other_start, 0)])
def test_drift_is_an_error(
    change: Callable[[EpisodeRecord], EpisodeRecord], at: int
) -> None:
    record = change(recipe()[FIRST])
    with pytest.raises(DatasetError, match=f"drifts at keyframe {at}"):
        next(iterate_steps(record))


@pytest.mark.parametrize("hz", [0, -10, 30, 200])
def test_rates_that_do_not_divide_a_second(hz: int) -> None:
    with pytest.raises(InvalidConfigError, match="10 is common"):
        next(iterate_steps(recipe()[FIRST], hz))
