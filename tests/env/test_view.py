"""One observation pipeline: environments, data and evaluation see the same."""

import pickle

import numpy as np
import pytest
from tiers import slow_but

import lemma
from lemma.dataset.rendered.capture import stored
from lemma.env.camera_rig import CameraRig, round_depth
from lemma.env.view import View
from lemma.evaluation.run.rollout import Rollout
from lemma.expert.plan_env import PlanEnv
from lemma.scene.raster import RASTER, decode_depth, encode_depth
from lemma.scene.scene import Scene
from lemma.tasks.suite import SUITE

MAP = ("rgb", "height_m", "coverage")


def played(task: str, index: int, steps: int) -> PlanEnv:
    """Return an environment after some sub-tasks of the expert; the arms are parked."""
    env = lemma.make(task, level="plan", split="test", index=index, observation="map")
    expert = lemma.ExpertPolicy(env)
    env.set_table()
    for _ in range(steps):
        env.step(expert.act())
    return env


@pytest.mark.render
@pytest.mark.parametrize("task", slow_but(SUITE, "hook"))
def test_environment_data_and_evaluation_see_the_same_to_the_bit(task: str) -> None:
    rig = CameraRig()
    for index in range(3):
        env = played(task, index, steps=index % 3)
        found = env.observe()
        assert found in env.observation_space
        seen = found["map"]

        rollout = Rollout(env.instance)
        rollout.episode.restore(env.episode.snapshot())
        evaluated = rollout.policy_input(rig).view

        scene = Scene(env.instance.scene)
        scene.restore(env.episode.simulation.scene.snapshot())
        rendered = stored(rig.look(scene))
        files = {
            "rgb": rendered["map_rgb"],
            "height_m": RASTER.decode_height(rendered["map_height"]),
            "coverage": rendered["map_height"] > 0,
        }
        for name in MAP:
            assert np.array_equal(seen[name], getattr(evaluated, name)), name
            assert np.array_equal(seen[name], files[name]), name
        assert np.array_equal(evaluated.joints, rendered["joints"])
        assert np.array_equal(evaluated.opening_m, rendered["opening_m"])
        assert seen["height_m"].max() > 0.04
        env.close()


@pytest.mark.render
def test_view_shows_its_moment_whenever_it_is_asked() -> None:
    env = lemma.make("stack", split="test", index=0, control="joint_velocity")
    env.reset()
    rig, scene = CameraRig(160, 120), env.episode.simulation.scene
    early, late = rig.look(scene), rig.look(scene)
    before = early.rgb.copy()
    for _ in range(20):
        env.step(np.full((2, 7), 0.1, np.float32))
    state = env.state_hash()
    assert np.array_equal(late.rgb, before)
    assert np.array_equal(late.cameras["robot_0"].rgb, early.cameras["robot_0"].rgb)
    assert not np.array_equal(rig.look(scene).rgb, before)
    assert env.state_hash() == state


def test_looking_costs_no_picture() -> None:
    env = lemma.make("stack", split="test", index=0)
    env.reset()
    view = env.view()
    assert view.joints.shape == (2, 6)
    assert view.joint_velocities is not None
    assert view.joint_velocities.shape == (2, 6)
    assert view.opening_m.shape == (2,)
    assert not {"cameras", "_map"} & set(vars(view))


@pytest.mark.render
def test_view_can_be_pickled() -> None:
    env = lemma.make("stack", split="test", index=0, width=64, height=48)
    env.reset()
    view = env.view()
    copy = pickle.loads(pickle.dumps(view))
    assert type(copy) is View
    assert np.array_equal(copy.height_m, view.height_m)
    assert np.array_equal(copy.cameras["robot_1"].rgb, view.cameras["robot_1"].rgb)


def test_depths_are_rounded_as_if_they_were_stored() -> None:
    depth_m = np.linspace(0.0, 7.0, 6000, dtype=np.float32).reshape(60, 100)
    depth_m[0, :3] = (np.inf, 6.55355, 0.00005)
    rounded = depth_m.copy()
    round_depth(rounded)
    assert np.array_equal(rounded, decode_depth(encode_depth(depth_m)))
